"""The source of a system that stands still, as a stranger would write it."""

SYSTEM = '''
import numpy as np
from slam.types import FrameEstimate, SlamResult, Status

class Still:
    """Says that nothing ever moves."""
    def __init__(self): self.stamps = []
    def process(self, frame):
        self.stamps.append(frame.stamp_s)
        status = Status.TRACKED if len(self.stamps) > 1 else Status.FIRST
        return FrameEstimate(frame.index, frame.stamp_s, np.eye(4), np.eye(4), status=status)
    def finish(self):
        n = len(self.stamps)
        return SlamResult(np.array(self.stamps), np.repeat(np.eye(4)[None], n, 0), {},
                          (Status.FIRST,) + (Status.TRACKED,) * (n - 1))

def make(intrinsics): return Still()
'''
