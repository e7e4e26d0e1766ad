"""Readers of sequences on disk: our own, TUM RGB-D, KITTI odometry and the VDO layout."""
