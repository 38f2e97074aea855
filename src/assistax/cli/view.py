"""`assistax view`."""

import sys
from collections.abc import Sequence

from assistax.cli.common import Count, File, Name, Number, Set, Switch, Target, teams_of


def view(
    target: Target,
    *,
    policy: Name = None,
    engine: Name = None,
    seed: Number = None,
    set: Set = (),
    port: Count = 8080,
    host: str = "127.0.0.1",
    html: File = None,
    native: Switch = False,
) -> None:
    """Watch episodes live in the browser, and push the person or the robot.

    For example:
      assistax view scratch
      assistax view runs/scratch-ippo-0 --set env.human.disability=tremor
      assistax view feeding --policy expert --html feeding.html

    Needs the extra `view`: pip install 'assistax[view]'. docs/viewer.md says more, also about other machines.

    Args:
      target: a run folder, a team file, or a task.
      policy: who plays: with a task trained (the team that comes with it; default), still, random, expert, ... as in
        `assistax render`. In the browser others can be chosen.
      engine: auto, mujoco, warp or mjx (default: as the run, else auto).
      seed: of the first episode's draws; fixed unless given.
      set: change any setting of the run or task, as in `assistax evaluate`.
      port: of the web server.
      host: whom it serves: 127.0.0.1 this machine alone (also over ssh -L), 0.0.0.0 everybody who reaches it.
      html: instead, write one episode into this file, a page that plays it without a server.
      native: instead, open MuJoCo's own window, on this machine's display.
    """
    from assistax.errors import UsageError
    from assistax.viewer import needs

    if html is not None and native:
        raise UsageError("Choose one of --html and --native.")
    if native:
        needs.check_display()
    else:
        needs.check_extra()
        needs.check_port(host, port) if html is None else needs.check_page(html)
    from assistax.evaluation.playing import EVALUATION_SEED

    casting, teams = castings(target, policy, engine, set)
    seed = EVALUATION_SEED if seed is None else seed
    if html is not None:
        from assistax.viewer.page import page

        page(*casting(teams[0], ()), seed, html)
        print(f"wrote {html}")
        return
    print(f"Preparing {target}; this compiles for some seconds.", file=sys.stderr)
    if native:
        from assistax.viewer.native import show

        show(*casting(teams[0], ()), seed)
        return
    from assistax.viewer.browser import Browser

    with Browser(casting, teams, seed, host, port) as browser:
        print(f"Open {browser.url} in a browser; stop with Ctrl-C.", flush=True)
        browser.run()


def castings(target: str, policy: str | None, engine: str | None, given: tuple[str, ...]):
    """(a function of a team's name and more settings that makes environment and team, the names to choose from).

    The first name is what was asked for.
    """
    from assistax.policies import SCRIPTED, scripted_team
    from assistax.tasks import is_task

    if policy is not None or is_task(target):
        names = list(dict.fromkeys([policy or "trained", "trained", *SCRIPTED]))

        def of_task(name, settings):
            env, teams, _ = teams_of(target, name, engine, _instead(given, settings))
            return env, teams[0]

        return of_task, names

    _, teams, _ = teams_of(target, None, engine, given)
    own = [f"seed {i}" if len(teams) > 1 else "its own" for i in range(len(teams))]

    def of_run(name, settings):
        env, teams, _ = teams_of(target, None, engine, _instead(given, settings))
        return env, scripted_team(name, env) if name in SCRIPTED else teams[own.index(name)]

    return of_run, [*own, *SCRIPTED]


def _instead(given: tuple[str, ...], chosen: Sequence[str]) -> tuple[str, ...]:
    """Settings that were given, with what was chosen later in their place."""
    names = {text.partition("=")[0] for text in chosen}
    return (*(text for text in given if text.partition("=")[0] not in names), *chosen)
