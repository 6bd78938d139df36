"""Configs of commands by their name; in tests, each choice of YAML files is composed once."""

import importlib
import pickle
from collections.abc import Sequence
from typing import Any, ClassVar

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult, ConfigSource
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

import eldenet.compose
from eldenet.cli.commands import module_of
from eldenet.compose import compose_config, config_folder


def composed(command: str, overrides: Sequence[str] = ()) -> Any:
    """What Hydra composes for ``command``, whose module makes its settings known."""
    importlib.import_module(module_of(command))
    return compose_config(command.replace("-", "_"), overrides)


class QuickLoader(ConfigLoaderImpl):
    """Hydra's own, which needs 0.1 s per config; it sets the values in a copy of what the choices give."""

    known: ClassVar[dict[Any, bytes]] = {}

    def load_configuration(
        self, config_name: str | None, overrides: list[str], run_mode: RunMode, *options: bool
    ) -> DictConfig:
        given = OverridesParser.create().parse_overrides(overrides)
        sources = [path.path for path in self.config_search_path.get_path() if path.provider != "schema"]
        usual = sources == ["pkg://hydra.conf", str(config_folder())]
        if not usual or any(one.is_sweep_override() for one in given):
            return super().load_configuration(config_name, overrides, run_mode, *options)
        chosen, values = [], []
        for one in given:
            is_choice = self.repository.group_exists(one.key_or_group) and not isinstance(one.value(), dict)
            (chosen if is_choice else values).append(one)
        schema = "".join(word.title() for word in str(config_name).split("_"))
        node = ConfigStore.instance().repo.get(f"{schema}Settings.yaml")
        lines = [one.input_line for one in chosen]
        key = (config_name, *lines, node and OmegaConf.get_type(node.node))
        if key not in self.known:
            self.known[key] = pickle.dumps(super().load_configuration(config_name, lines, run_mode, *options))
        config = pickle.loads(self.known[key])
        self._apply_overrides_to_config(values, config)
        return config


def compose_each_choice_once() -> None:
    """Compose each choice and parse each file of the package's settings once, in this process."""
    eldenet.compose.ConfigLoaderImpl = QuickLoader
    Plugins.instance()  # makes the sources known
    for scheme in ("file", "pkg"):
        _parse_once(SourcesRegistry.instance().resolve(scheme))


def _parse_once(kind: type[ConfigSource]) -> None:
    parse, parsed, own = kind.load_config, {}, ("hydra.conf", str(config_folder()))

    def load_config(source: ConfigSource, config_path: str) -> ConfigResult:
        if source.path not in own:
            return parse(source, config_path)
        if config_path not in parsed:
            parsed[config_path] = pickle.dumps(parse(source, config_path))
        return pickle.loads(parsed[config_path])

    kind.load_config = load_config
