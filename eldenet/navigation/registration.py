"""Tell Gymnasium of the environment: importing this does.

``gymnasium.make("eldenet.navigation.registration:eldenet/ArenaNav-v0")`` imports it by itself. Gymnasium
reads the entry points of packages no more since 1.0; pyproject's ``gymnasium.envs`` is for what still does.
"""


def register() -> None:
    """Register ``eldenet/ArenaNav-v0``; loads neither the environment nor the simulator."""
    from gymnasium.envs.registration import register, registry

    if "eldenet/ArenaNav-v0" not in registry:
        register(
            "eldenet/ArenaNav-v0",
            entry_point="eldenet.navigation.env:ArenaNavEnv",
            vector_entry_point="eldenet.navigation.env:ArenaNavVectorEnv",
        )


register()
