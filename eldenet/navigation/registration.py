"""Registers the environment with Gymnasium on import.

``gymnasium.make("eldenet.navigation.registration:eldenet/ArenaNav-v0")`` imports this module. Since 1.0
Gymnasium ignores the ``gymnasium.envs`` entry points of packages; pyproject's is for tools that read them.
"""


def register() -> None:
    """Register ``eldenet/ArenaNav-v0`` without loading the environment or the simulator."""
    from gymnasium.envs.registration import register, registry

    if "eldenet/ArenaNav-v0" not in registry:
        register(
            "eldenet/ArenaNav-v0",
            entry_point="eldenet.navigation.env:ArenaNavEnv",
            vector_entry_point="eldenet.navigation.env:ArenaNavVectorEnv",
        )


register()
