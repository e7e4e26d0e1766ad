"""Noise models, seeded and off by name: truth goes in, what a sensor gives comes out."""

from simbench.sensors.boxes import BoxNoise, box_noise, boxes_of_masks, class_number
from simbench.sensors.depth import (
    DepthModel,
    GaussianDepth,
    KinectDepth,
    StereoDepth,
    apply_depth_noise,
    clean_depth,
    depth_sigma,
)
from simbench.sensors.flow import FlowNoise, NoiseField, draw_noise, flow_noise
from simbench.sensors.hsv import HsvConfig, hsv_masks
from simbench.sensors.masks import (
    MaskNoise,
    majority_objects,
    mask_noise,
    shuffle_labels,
)
from simbench.sensors.rgb import RgbNoise, apply_rgb_noise
from simbench.sensors.spec import SENSORS, SensorSpec, find_sensor
from simbench.sensors.streams import Stage, generator

__all__ = [
    "SENSORS", "BoxNoise", "DepthModel", "FlowNoise", "GaussianDepth", "HsvConfig", "KinectDepth",
    "MaskNoise", "NoiseField", "RgbNoise", "SensorSpec", "Stage", "StereoDepth",
    "apply_depth_noise", "apply_rgb_noise", "box_noise", "boxes_of_masks", "class_number",
    "clean_depth", "depth_sigma", "draw_noise", "find_sensor", "flow_noise", "generator",
    "hsv_masks", "majority_objects", "mask_noise", "shuffle_labels",
]
