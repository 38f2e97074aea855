"""`assistax evaluate`."""

from assistax.cli.common import Count, Json, Name, Number, Partner, Set, Target, print_json, print_table, teams_of


def evaluate(
    target: Target,
    *,
    policy: Name = None,
    partner: Partner = (),
    episodes: Count = 64,
    engine: Name = None,
    seed: Number = None,
    set: Set = (),
    json: Json = False,
) -> None:
    """Play whole episodes on fixed seeds; print means with 95 % confidence intervals.

    For example:
      assistax evaluate runs/scratch-ippo-0
      assistax evaluate scratch --policy expert
      assistax evaluate scratch --policy random --json
      assistax evaluate runs/scratch-ippo-0 --set env.human.disability=weakness

    Args:
      target: a run folder, a team file, or a task together with --policy.
      policy: with a task, who plays: trained (the team that comes with it), still, random, expert or considerate
        (the robot; the human is then still, shows what it is to work on: offer, offer_slowly, or draws back: withdraw).
      partner: AGENT=WHO who plays in place of the team's own, as in `assistax train`: human=shy,
        human=POP:random/test.
      episodes: how many (intervals are over them).
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the evaluation's draws; fixed unless given.
      set: change any setting of the run or task. Who the person is, see `assistax humans --help`:
        env.human.disability, .preference, .people, .visibility.
      json: print JSON instead of a table.
    """
    from assistax.evaluation.playing import EVALUATION_SEED, play, summarize

    env, teams, about = teams_of(target, policy, engine, set, partner)
    start = EVALUATION_SEED if seed is None else seed
    results = [summarize(play(env, team, episodes, start)) for team in teams]
    if json:
        print_json({**about, **results[0]} if len(results) == 1 else {**about, "seeds": results})
        return
    for result in results:
        print_table({**about, **result})
