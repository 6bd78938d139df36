"""Tell Gymnasium of the environment: pyproject's entry point ``gymnasium.envs`` calls :func:`register`."""


def register() -> None:
    """Register ``eldenet/ArenaNav-v0``; loads neither the environment nor the simulator."""
    from gymnasium.envs.registration import register, registry

    if "eldenet/ArenaNav-v0" not in registry:
        register(
            "eldenet/ArenaNav-v0",
            entry_point="eldenet.navigation.env:ArenaNavEnv",
            vector_entry_point="eldenet.navigation.env:ArenaNavVectorEnv",
        )
