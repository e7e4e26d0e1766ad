"""DPL-SLAM: points and lines with descriptors, dynamic ones removed, keyframes."""
