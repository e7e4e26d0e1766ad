"""One system on one scene, each input true, noisy or estimated: which part of the error is whose?

What `simbench run` does, step by step: a world, its pictures and truth as a sequence, a feed of
what the system sees of it, the run, its score.
"""

import argparse

import slam
from simbench.inputs import Feed, InputChoice
from simbench.render import make_renderer
from simbench.run import run, score
from simbench.simulate import SimulatedSequence
from simbench.world import make_world

CHOICES = {
    "all true": InputChoice(),
    "noisy flow": InputChoice(flow="noisy", flow_sigma_px=0.3),
    "flow from the images": InputChoice(flow="dis"),
    "depth of a Kinect": InputChoice(sensor="kinect"),
    "both": InputChoice(sensor="kinect", flow="dis"),
}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    frames = parser.parse_args(arguments).frames

    world = make_world("SwingingBoxes-v0", seed=0, size=(320, 240))
    renderer = make_renderer("mujoco", world)
    sequence = SimulatedSequence(world, renderer, frames)
    for name, choice in CHOICES.items():
        feed = Feed(sequence, choice, seed=0)
        record = run(slam.make("sdpl", sequence.intrinsics), feed)
        metrics = score(sequence.truth.trajectories, record)
        objects = metrics["objects"]["mean"]
        print(f"{name:<21} camera {1e3 * metrics['camera']['E_t']:6.3f} mm, objects "
              f"{1e3 * objects.get('E_t', float('nan')):6.3f} mm, coverage "
              f"{100 * objects['coverage']:.0f} %")
    renderer.close()


if __name__ == "__main__":
    main()
