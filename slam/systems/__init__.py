"""Whole SLAM systems: sequences of the stages below."""
