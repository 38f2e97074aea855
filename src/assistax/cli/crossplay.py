"""`assistax crossplay`."""

from pathlib import Path
from typing import Annotated

import tyro

from assistax.cli.common import Count, File, Json, Name, Number, Set, aligned, print_json, teams_of
from assistax.errors import UsageError

Targets = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN|TASK|POLICY ...")]


def crossplay(
    targets: Targets,
    *,
    episodes: Count = 64,
    engine: Name = None,
    seed: Number = None,
    set: Set = (),
    out: File = None,
    json: Json = False,
) -> None:
    """Let the robot of every team play with the person of every team, as in the paper's cross-play matrices.

    Prints return and success by pair, a row per robot and a column per person. The person brings body and preferences
    along: a pair plays in the environment of the person's team.

    For example:
      assistax crossplay runs/scratch-ippo-0 runs/scratch-mappo-0
      assistax crossplay scratch runs/scratch-ippo-0 still expert --out crossplay.png

    Args:
      targets: teams of one task: run folders (each seed is a team), team files, a task (the trained team that comes
        with it), or scripted teams (still, random, expert, considerate, offer, withdraw).
      episodes: of each pair.
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the episodes' draws; fixed unless given.
      set: change any setting of all teams, as in `assistax evaluate`.
      out: a .png, .svg or .pdf of the matrix of returns.
      json: print JSON instead of a table.
    """
    from assistax.evaluation.playing import EVALUATION_SEED
    from assistax.results.figures import check_format, save
    from assistax.stamp import stamp
    from assistax.teamwork.crossplay import cross_play, picture, table

    if out is not None:
        check_format(out)
    report = cross_play(_entrants(targets, engine, set), episodes, EVALUATION_SEED if seed is None else seed)
    if out is not None:
        save(picture(report), out)
    if json:
        print_json(report | stamp())
        return
    print(aligned(*table(report)))
    if out is not None:
        print(f"wrote {out}")


def _entrants(targets: tuple[str, ...], engine: str | None, assignments: tuple[str, ...]):
    from assistax.policies import SCRIPTED, scripted_team
    from assistax.tasks import is_task
    from assistax.teamwork.crossplay import Entrant

    found = {}
    for target in targets:
        if target not in SCRIPTED:
            env, teams, _ = teams_of(target, "trained" if is_task(target) else None, engine, assignments)
            name = f"trained {env.name}" if is_task(target) else Path(target).name.removesuffix(".safetensors")
            names = [name] if len(teams) == 1 else [f"{name} {i + 1}" for i in range(len(teams))]
            found[target] = [Entrant(name, env, team) for name, team in zip(names, teams, strict=True)]
    if not found:
        raise UsageError("Name a run folder, a team file or a task; scripted teams alone do not say what to do.")
    env = next(iter(found.values()))[0].env
    for target in targets:
        if target in SCRIPTED:
            players = dict(zip(env.agents, SCRIPTED[target], strict=True))
            found[target] = [Entrant(target, env, scripted_team(target, env), players)]
    if twice := [target for target in found if targets.count(target) > 1]:
        raise UsageError(f"{twice[0]} is there twice; name every team once.")
    return [entrant for target in targets for entrant in found[target]]
