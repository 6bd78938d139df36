"""eldenet for ROS 2. ``messages``, ``scan`` and ``driving`` need no ROS; the ``*_node`` modules are thin."""
