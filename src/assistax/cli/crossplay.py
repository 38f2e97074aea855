"""`assistax crossplay`."""

from pathlib import Path
from typing import Annotated

import tyro

from assistax.cli.common import Count, File, Json, Name, Number, Partner, Set, aligned, print_json, teams_of
from assistax.errors import UsageError

Targets = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN|TASK|POLICY ...")]


def crossplay(
    targets: Targets,
    *,
    episodes: Count = 64,
    engine: Name = None,
    seed: Number = None,
    set: Set = (),
    partner: Partner = (),
    out: File = None,
    json: Json = False,
) -> None:
    """Let the robot of every team play with the person of every team, as in the paper's cross-play matrices.

    Prints return and success by pair, a row per robot and a column per person. The person brings body and preferences
    along: a pair plays in the environment of the person's team.

    For example:
      assistax crossplay runs/scratch-ippo-0 runs/scratch-mappo-0
      assistax crossplay scratch runs/scratch-ippo-0 still expert --out crossplay.png
      assistax crossplay runs/robot --partner human=populations/scratch-v1:random/test

    Args:
      targets: teams of one task: run folders (each seed is a team), team files, a task (the trained team that comes
        with it), or scripted teams (still, random, expert, considerate, offer, withdraw).
      episodes: of each pair.
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the episodes' draws; fixed unless given.
      set: change any setting of all teams, as in `assistax evaluate`.
      partner: human=POP or human=POP:KIND/PART lets every robot play with everybody of a population instead, a column
        per member.
      out: a .png, .svg or .pdf of the matrix of returns.
      json: print JSON instead of a table.
    """
    from assistax.evaluation.playing import EVALUATION_SEED
    from assistax.results.figures import check_format, save
    from assistax.stamp import stamp
    from assistax.teamwork.crossplay import cross_play, picture, table

    if out is not None:
        check_format(out)
    entrants, people = _entrants(targets, engine, set, partner)
    report = cross_play(entrants, episodes, EVALUATION_SEED if seed is None else seed, people)
    if out is not None:
        save(picture(report), out)
    if json:
        print_json(report | stamp())
        return
    print(aligned(*table(report)))
    if out is not None:
        print(f"wrote {out}")


def _entrants(targets: tuple[str, ...], engine: str | None, assignments: tuple[str, ...], partners: tuple[str, ...]):
    """The targets' teams and, where a population is named, its members, as people of whom each plays alone."""
    from assistax.policies import SCRIPTED, scripted_team
    from assistax.tasks import is_task
    from assistax.teamwork.crossplay import Entrant
    from assistax.training import splits
    from assistax.training.partners import split_pair
    from assistax.training.population import is_population

    whose = dict(map(split_pair, partners))
    if partners and not (len(partners) == 1 and is_population(whose.get("human", ""))):
        raise UsageError(f"Cross-play takes --partner human=POP or human=POP:KIND/PART, not {' '.join(partners)}.")
    scripted = {name for pair in SCRIPTED.items() for name in (pair[0], *pair[1])}
    found = {}
    for target in targets:
        if target not in SCRIPTED:
            env, teams, _ = teams_of(target, "trained" if is_task(target) else None, engine, assignments, partners)
            name = f"trained {env.name}" if is_task(target) else Path(target).name.removesuffix(".safetensors")
            if name in scripted or [Path(one).name for one in targets].count(Path(target).name) > 1:
                name = target  # with its folder, where the last part alone could be somebody else
            names = [name] if len(teams) == 1 else [f"{name} {i + 1}" for i in range(len(teams))]
            found[target] = [Entrant(name, env, team) for name, team in zip(names, teams, strict=True)]
    if not found:
        raise UsageError("Name a run folder, a team file or a task; scripted teams alone do not say what to do.")
    env, team = (first := next(iter(found.values()))[0]).env, first.team
    members = splits.named(whose["human"])[1].ids if whose else ()
    people = [Entrant(one[:12], env, team, person=i) for i, one in enumerate(members)]
    for target in targets:
        if target in SCRIPTED:
            players = dict(zip(env.agents, SCRIPTED[target], strict=True))
            found[target] = [Entrant(target, env, scripted_team(target, env), players)]
    if twice := [target for target in found if targets.count(target) > 1]:
        raise UsageError(f"{twice[0]} is there twice; name every team once.")
    return [entrant for target in targets for entrant in found[target]], people
