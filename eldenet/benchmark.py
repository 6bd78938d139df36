"""``python -m eldenet.benchmark``: models, sizes, batches, runtimes, precisions, threads -> one table."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.config import build_benchmark
from eldenet.system.extras import require

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("benchmark")
def main(config: "DictConfig", folder: Path) -> None:
    """Measure; ``folder`` is not used, results go to ``output``."""
    if config.study is not None:
        refuse_unread(
            ("models", "sizes"), "not read with study=, whose rows name the networks and their inputs"
        )
    require("the plot of latencies", "matplotlib")
    setup = build_benchmark(config)
    from eldenet.deploy.benchmarking.run import benchmark

    benchmark(setup)


if __name__ == "__main__":
    main()
