"""What commands share: how arguments are written, who plays, how reports are printed."""

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import arg
from tyro.constructors import PrimitiveConstructorSpec

from assistax.errors import UsageError, choose
from assistax.files import check_folder

Task = Annotated[str, tyro.conf.Positional]
Target = Annotated[str, tyro.conf.Positional, arg(metavar="RUN|TASK")]
Runs = Annotated[tuple[Path, ...], tyro.conf.Positional, arg(metavar="RUN ...", help_behavior_hint="")]
# Optional arguments, whose defaults the descriptions say.
Name = Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")]
File = Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")]
_WHOLE = PrimitiveConstructorSpec(
    nargs=1,
    metavar="N",
    instance_from_str=lambda words: whole_number(words[0]),
    is_instance=lambda value: value is None or isinstance(value, int),
    str_from_instance=lambda value: [str(value)],
)
Number = Annotated[int | None, arg(metavar="N", help_behavior_hint=""), _WHOLE]
Count = Annotated[int, arg(metavar="N"), _WHOLE]
Switch = Annotated[bool, arg(help_behavior_hint="")]
Partner = Annotated[tuple[str, ...], arg(metavar="AGENT=WHO ...", help_behavior_hint="")]
Words = Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="")]
Json = Annotated[bool, arg(name="json", help_behavior_hint="")]
ExecutorSet = Annotated[tuple[str, ...], arg(metavar="NAME=VALUE ...", help_behavior_hint="")]
Set = Annotated[tuple[str, ...], arg(name="set", metavar="NAME=VALUE ...", help_behavior_hint="")]


def whole_number(text: str) -> int:
    """ "1000000", "1_000_000", "1e6" or "2.5e6"; raises ValueError for what is not whole."""
    value = float(text)
    if not value.is_integer():
        raise ValueError(f"{text} is not a whole number")
    return int(value) if (abs(value) < 2**53 and "e" in text.lower()) or "." in text else int(text)


def teams_of(
    target: str, policy: str | None, engine: str | None, assignments: tuple[str, ...], partners: tuple[str, ...] = ()
):
    """(env, teams by seed, what they are) of a run folder, a team file, or a task with a policy's name.

    `partners` ("human=POP:random/test") play in place of who was there; a population brings its people along.
    """
    from assistax.settings import parse_assignments
    from assistax.training.configuration import people_of
    from assistax.training.partners import find_partner, split_pair

    settings = people_of(partners) | parse_assignments(assignments)
    env, teams, about = _teams_of(target, policy, engine, settings, partners)
    for text in partners:
        agent, name = split_pair(text)
        choose("agent", agent, env.agents)
        player = find_partner(name, env, agent).player
        teams = [team | {agent: player} for team in teams]
        about = about | {"partners": list(partners)}
    return env, teams, about


def _teams_of(target: str, policy: str | None, engine: str | None, settings: dict[str, Any], partners: tuple[str, ...]):
    from assistax.env import Env
    from assistax.policies import SCRIPTED, scripted_team
    from assistax.tasks import TASKS, is_task, task_spec
    from assistax.training.configuration import configure, read_config, to_play
    from assistax.training.partners import split_pair
    from assistax.training.run import Run
    from assistax.training.team_file import load_team, trained_file

    if policy == "trained":
        env, team = load_team(trained_file(target), settings, engine)
        if env.name != (newest := task_spec(target).id):
            print(f"No trained team comes with {newest} yet: this is the one of {env.name}.", file=sys.stderr)
        return env, [team], {"task": env.name, "policy": policy}
    if policy is not None:
        choose("policy", policy, ["trained", *SCRIPTED])
        config = configure(target, settings, engine=engine)
        env = Env(target, config.engine, config.env, config.task_config)
        return env, [scripted_team(policy, env)], {"task": env.name, "policy": policy}
    if is_task(target):
        raise UsageError(f"Say who plays {target}: --policy trained, still, random, expert, ..., or give a run folder.")
    path = Path(target)
    if path.suffix == ".safetensors" and path.is_file():
        env, team = load_team(path, settings, engine)
        return env, [team], {"task": env.name, "team": target}
    if not path.is_dir():
        raise UsageError(f"{target!r} is neither a run folder, nor a team file, nor a task ({', '.join(TASKS)}).")
    config = read_config(path)
    frozen = dict(map(split_pair, config.partners))
    others = {agent for agent, _ in map(split_pair, partners)}  # who plays them is found by the caller
    copies = tuple(text for text in config.partner_copies if split_pair(text)[0] not in others)
    kept = tuple(f"{agent}={'still' if agent in others else name}" for agent, name in frozen.items())
    run = Run.open(path, to_play(config) | settings, engine=engine, partners=kept, partner_copies=copies)
    return run.env, run.teams(), {"task": run.config.task, "run": target}


def find_executor(processes: int | None, executor: str | None, assignments: tuple[str, ...], here: bool = False):
    """The executor that is asked for, None where this process does the work; raises UsageError if it is not there.

    Without a wish it is `local`, or with `here` this process.
    """
    from assistax.executors.drive import executor as find
    from assistax.settings import parse_assignments

    if executor is None and not assignments and (processes == 1 or (processes is None and (here or _by_itself()))):
        return None
    using = find("local" if executor is None else executor, parse_assignments(assignments, "--executor-set"))
    using.room(processes, processes or 1)
    return using


def _by_itself() -> bool:
    """Whether processes beside this one would be in each other's way: on an accelerator, or as an executor has more."""
    import jax

    from assistax.executors.jobs import is_worker
    from assistax.executors.local import usable_cores

    return is_worker() or len(usable_cores()) == 1 or jax.default_backend() != "cpu"


def duration(text: str) -> float:
    """Seconds of "90s", "9m" or "1.5h"."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text)
    if not match or not float(match[1]):
        raise UsageError(f"A budget is a time like 90s, 9m or 1.5h, not {text!r}.")
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600}[match[2]]


def print_json(report: Any) -> None:
    """A report for other programs."""
    print(json.dumps(report, indent=2))


def share_of_success(report: dict[str, Any]) -> str:
    """ "92%", and where harm is measured "92%, safely 90%"."""
    safely = f", safely {report['safe_success_rate']:.0%}" if "safe_success_rate" in report else ""
    return f"{report['success_rate']:.0%}{safely}"


def print_table(report: dict[str, Any], indent: str = "") -> None:
    """A report for people: a line for each number, pairs as intervals."""
    for name, value in report.items():
        if isinstance(value, dict):
            print(f"{indent}{name}")
            print_table(value, indent + "  ")
        else:
            if isinstance(value, (list, tuple)):
                value = " to ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in value)
            elif isinstance(value, float):
                value = f"{value:.4g}"
            print(f"{indent}{name:{28 - len(indent)}} {'none' if value is None else value}")


def aligned(head: list[str], cells: list[list[str]]) -> str:
    """A table in aligned columns."""
    widths = [max(map(len, column)) for column in zip(head, *cells, strict=True)]
    rows = (head, *cells)
    return "\n".join("  ".join(f"{x:{w}}" for x, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def film_path(out: Path | None, width: int = 2, height: int = 2) -> Path | None:
    """`out`, if a film of so many pixels can go there; asked before anything is played."""
    from assistax.evaluation.film import check_format

    check_format(out or Path("TASK.mp4"), width, height)
    if out is not None:
        check_folder(out)
    return out


def check_alone(given: Mapping[str, Any]) -> None:
    """Raise UsageError if any of these options, by name, is given beside --resume, which would ignore it."""
    if extra := [name for name, value in given.items() if value is not None]:
        raise UsageError(f"--resume takes everything from the folder; leave out --{extra[0]}.")


def film_episode(result, path: Path | None, plain: bool, **camera) -> None:
    """Film the typical episode of what an Evaluator returned; without a path into TASK.mp4."""
    from assistax.evaluation.film import film

    filmed = result["filmed"]
    path = path or Path(f"{filmed.task}.mp4")
    film(filmed, path, plain, **camera)
    print(f"wrote {path}")


def free_folder(name: str) -> Path:
    """runs/NAME or, if there is one, runs/NAME-2 and so on."""
    folder, number = Path("runs") / name, 2
    while folder.exists():
        folder, number = Path("runs") / f"{name}-{number}", number + 1
    return folder
