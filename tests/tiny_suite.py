"""A suite of few small frames, as a user writes one."""

SUITE = """
schema: 1
name: tiny
description: Two systems on few small frames.
systems: [sdpl]
seeds: 0-1
metrics: [camera.E_t, objects.mean.E_t]
cases:
  boxes:
    scene: SwingingBoxes-v0
    frames: 4
    size: 96x72
    sensor: gaussian
    sweep: {texture: [1, 0.2]}
"""
