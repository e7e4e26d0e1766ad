"""Exact truth of a simulated scene: flow, occlusion, scene flow and visible edges."""

from simbench.truth.edges import visible_edges
from simbench.truth.flow import flow_between
from simbench.truth.rays import RayCaster

__all__ = ["RayCaster", "flow_between", "visible_edges"]
