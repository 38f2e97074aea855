"""The command line: `assistax --help`."""

import os
import sys
from pathlib import Path
from typing import Any

import tyro

from assistax.cli import population, teamwork
from assistax.cli.bench import bench
from assistax.cli.crossplay import crossplay
from assistax.cli.doctor import doctor
from assistax.cli.evaluate import evaluate
from assistax.cli.export import export
from assistax.cli.humans import humans
from assistax.cli.play import play
from assistax.cli.plot import plot
from assistax.cli.render import render
from assistax.cli.reproduce import reproduce
from assistax.cli.settings import settings
from assistax.cli.sweep import sweep
from assistax.cli.table import table
from assistax.cli.tasks import tasks
from assistax.cli.train import train
from assistax.cli.view import view
from assistax.errors import AssistaxError, UsageError, choose

DESCRIPTION = "A robot arm and a person, both with policies of their own: train, evaluate, watch."
COMMANDS = (
    *(train, sweep, play, evaluate, crossplay, render, view, table, plot),
    *(export, reproduce, tasks, settings, humans, doctor, bench),
)
# Commands of several words, with their own overview.
GROUPS: dict[str, tuple[str, dict[str, Any]]] = {
    "population": ("Train, gather, split and look at populations of partners.", population.COMMANDS),
    "teamwork": ("Measure robots with people they have never met.", teamwork.COMMANDS),
}


def overview() -> str:
    """What `assistax --help` prints: a line for each command."""
    lines = [f"  {command.__name__:11} {(command.__doc__ or '').partition(chr(10))[0]}" for command in COMMANDS]
    lines += [f"  {name:11} {what}" for name, (what, _) in GROUPS.items()]
    return "\n".join(
        ["usage: assistax COMMAND ...", "", DESCRIPTION, "", *lines, "", "assistax COMMAND --help explains."]
    )


def main() -> None:
    """Entry point of the `assistax` command."""
    commands: dict[str, Any] = {command.__name__: command for command in COMMANDS}
    group = sys.argv[1] if sys.argv[1:2] and sys.argv[1] in GROUPS else None
    if sys.argv[1:] in ([], ["-h"], ["--help"]):
        print(overview())
        return
    if sys.argv[1:] == ["--version"]:
        import assistax

        print(f"assistax {assistax.__version__}")
        return
    # Programs without physics are compiled once per machine; read when JAX is first imported.
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "assistax" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    options = [word.partition("=")[0] for word in sys.argv[1:] if word.startswith("--")]
    try:
        if twice := [option for option in options if options.count(option) > 1]:
            raise UsageError(f"{twice[0]} is there twice, and one would replace the other; put its values behind one.")
        words = sys.argv[2:] if group else sys.argv[1:]
        if words and not words[0].startswith("-"):
            choose("command", words[0], GROUPS[group][1] if group else (*commands, *GROUPS))
        tyro.extras.subcommand_cli_from_dict(
            GROUPS[group][1] if group else commands,
            prog=f"assistax {group}" if group else "assistax",
            description=GROUPS[group][0] if group else DESCRIPTION,
            args=sys.argv[2:] if group else sys.argv[1:],
            config=(tyro.conf.FlagCreatePairsOff,),
        )
    except AssistaxError as error:
        print(f"assistax: {error}", file=sys.stderr)
        sys.exit(2)
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and "RESOURCE_EXHAUSTED" not in str(error):  # as JAX says it
            raise
        print("assistax: There is too little memory; take fewer environments or episodes.", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the reader has seen enough, as in `assistax humans --people paper630 | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
