"""Versions of what navigation computes: they tell old results from new.

Raise a version whenever the results that it names change. Golden episodes in the tests fail where episodes
change and their version does not.
"""

#: Of how drivers are trained. A training that stopped goes on with the version that began it.
TRAINING_VERSION = 1
#: Of arenas, sensors, drivers and rendering: of everything that an episode's outcome rests on.
EPISODE_VERSION = 1
