"""The command ``eldenet``: the list of commands, their start, and shell completion.

Nothing heavy is imported here, so the list appears at once.
"""

import difflib
import importlib
import os
import sys
from collections.abc import Sequence

from eldenet.system.terminal import print_error, terminal

#: Command -> what it does. ``check-data`` is the module ``eldenet.check_data``.
COMMANDS = {
    "train": "train a network and score its best epoch",
    "adapt": "tune trained weights to your own camera and place",
    "evaluate": "score a checkpoint on a data set, under a protocol",
    "predict": "depth of a picture, a folder of pictures, a video or a camera",
    "demo": "a network in your browser: photo, video or webcam",
    "export": "write a network as a file for ONNX Runtime or OpenVINO",
    "benchmark": "latency and memory of networks, sizes, runtimes and precisions",
    "report": "tables of finished runs: Markdown, CSV and LaTeX",
    "study": "train the missing runs of a study",
    "check-data": "is a data set complete, and does it hold what its config says?",
    "navigate": "drive a simulated robot by depth; evaluate or train its driver",
}

COMPLETION = 'give bash or zsh, as in ~/.bashrc: eval "$(eldenet completion bash)"'

# Hydra completes the settings of a command: it reads COMP_LINE and drops its first word. Names of files may
# hold anything, so no script here reads them: the shell itself completes and quotes them.
_BASH = """\
_eldenet() {
    local line="${COMP_LINE:0:$COMP_POINT}" word="$2" typed each all=()
    typed="${line##*[[:space:]]}"
    COMPREPLY=()
    if [ "$COMP_CWORD" -le 1 ]; then
        all=(NAMES completion)
    elif [[ "$typed" == *"$word" && "$typed" != *=[./~]* ]]; then
        IFS=" " read -r -a all < <(
            COMP_LINE="${line#*[[:space:]]}" eldenet "${COMP_WORDS[1]}" -sc query=bash 2>/dev/null
        )
    fi
    for each in "${all[@]}"; do
        [[ "$each" == "$typed"* && "$each" != *[!A-Za-z0-9_=./+~@:,-]* ]] || continue
        [[ "$each" == *[=./] ]] || each+=" "
        COMPREPLY+=("${each#"${typed%"$word"}"}")
    done
    [ "${#COMPREPLY[@]}" != 0 ] || compopt +o nospace 2>/dev/null
}
[[ "$COMP_WORDBREAKS" == *=* ]] || COMP_WORDBREAKS+="="
complete -o nospace -o default -F _eldenet eldenet
"""
_ZSH = """\
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit; }
_eldenet() {
    local -a all
    if (( CURRENT == 2 )); then
        all=(NAMES completion)
    elif [[ "$PREFIX" != *=[./~]* ]]; then
        all=("${(@s: :)$(
            COMP_LINE="${(j: :)words[2,CURRENT-1]} $PREFIX" eldenet "$words[2]" -sc query=bash 2>/dev/null
        )}")
    fi
    all=(${all:#*[^A-Za-z0-9_=./+~@:,-]*})
    compadd -S "" -- ${(M)all:#*[=./]}
    compadd -- ${all:#*[=./]}
    (( compstate[nmatches] )) || { compset -P "*="; _files; }
}
compdef _eldenet eldenet
"""
SCRIPTS = {"bash": _BASH, "zsh": _ZSH}


def main(words: Sequence[str] | None = None) -> None:
    """Run ``eldenet <command> <settings>``, which is ``python -m eldenet <command> <settings>``.

    Args:
        words: of the command line; None: those of this process.
    """
    first, *rest = list(sys.argv[1:] if words is None else words) or ["--help"]
    name = first.replace("_", "-")
    with terminal():
        if first in ("-h", "--help", "help"):
            _print(command_list())
        elif first == "--version":
            import eldenet

            _print(f"eldenet {eldenet.__version__}")
        elif name == "completion":
            _print(completion(rest[0] if rest else ""))
        elif name in COMMANDS:
            _start(name, rest)
        else:
            _fail(unknown(first))


def command_list() -> str:
    """Return the commands with a line each, within 80 columns."""
    lines = [f"  {name:15} {text}" for name, text in COMMANDS.items()]
    return "\n".join(
        [
            "eldenet <command> [setting=value ...]",
            "",
            *lines,
            f"  {'completion':15} script that completes commands and settings: bash, zsh",
            "",
            "eldenet <command> --help shows its settings and --cfg job their values.",
            "python -m eldenet <command> is the same.",
        ]
    )


def completion(shell: str) -> str:
    """Return the script that makes a shell complete commands and their settings."""
    if shell in ("-h", "--help"):
        return COMPLETION
    if shell not in SCRIPTS:
        _fail(COMPLETION)
    return SCRIPTS[shell].replace("NAMES", " ".join(COMMANDS)).rstrip()


def unknown(word: str) -> str:
    """Return the line for a command that does not exist."""
    nearest = difflib.get_close_matches(word.replace("_", "-"), COMMANDS, 1)
    return f"there is no command {word}: " + (
        f"did you mean {nearest[0]}?" if nearest else f"choose one of {', '.join(COMMANDS)}"
    )


def _start(name: str, words: Sequence[str]) -> None:
    """Run a command as ``python -m`` does."""
    sys.argv = [f"eldenet {name}", *words]
    completes = "-sc" in words  # pressing Tab must import nothing that lies here
    if not (completes or {"", os.getcwd()} & set(sys.path) or sys.flags.safe_path):
        sys.path.insert(0, os.getcwd())  # so that settings may name code that lies here
    importlib.import_module(module_of(name)).main()


def module_of(name: str) -> str:
    """Return the module of a command, as ``python -m`` takes it."""
    return f"eldenet.{name.replace('-', '_')}"


def _print(text: str) -> None:
    print(text)  # noqa: T201


def _fail(line: str) -> None:
    print_error(line)
    raise SystemExit(1)
