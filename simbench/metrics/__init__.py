"""Errors of an estimate against truth, as pure functions of poses.

E_t, E_R: `motion`; ATE, RPE: `trajectory`; which track belongs to which true object:
`association`; what counts as moving, and how smooth a recording's truth is: `moving`.
`camera` and `objects` put them together into the blocks of metrics.json.
"""
