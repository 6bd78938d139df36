"""Room that drivers keep around the robot's footprint [m].

Planned paths keep more, from the robot's center: ``COSTS`` of
:mod:`eldenet.navigation.planners.plan_and_steer`, and with A* and the dynamic window
:data:`eldenet.simulation.arenas.INFLATION`, by which arenas are drawn too. What a camera may miss is in
:mod:`eldenet.navigation.ranges`, how slowly a robot passes near things in ``Observer``.
"""

# The learned driver. Its weights are only valid for this margin.
DRIVER_MARGIN = 0.04  # added to the footprint on all sides, in the free times that it sees

# The dynamic window, alone or along a path.
WINDOW_MARGIN = 0.05  # added to the footprint on all sides
WINDOW_ROOM = 0.10  # least clearance of an arc; the robot can then turn on the spot (its corners stick out)
TURNING_GAP = 0.03  # between corners and points while turning on the spot

# The learned driver on a planned path.
STEER_MARGIN = 0.04  # added to the footprint on all sides
STEER_ROOM = 0.06  # least clearance of an arc
FAST_ROOM = 0.12  # least clearance of an arc that is driven faster than the learned driver would
WINDOW_SLACK = 0.025  # room that an arc may lose where there is little
BESIDE = 0.35  # free width on both sides of the straight line to the next way-point
