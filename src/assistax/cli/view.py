"""`assistax view`."""

import sys

from assistax.cli.common import File, Name, Number, Set, Target, teams_of


def view(
    target: Target,
    *,
    policy: Name = None,
    engine: Name = None,
    seed: Number = None,
    set: Set = (),
    port: int = 8080,
    host: str = "127.0.0.1",
    html: File = None,
    native: bool = False,
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
    from assistax.errors import UsageError, choose
    from assistax.evaluation.playing import EVALUATION_SEED
    from assistax.policies import SCRIPTED, scripted_team
    from assistax.tasks import is_task
    from assistax.viewer import needs

    if html is not None and native:
        raise UsageError("Choose one of --html and --native.")
    needs.check_display() if native else needs.check_extra()
    if html is not None:
        needs.check_page(html)
    elif not native:
        needs.check_port(host, port)
    seed = EVALUATION_SEED if seed is None else seed
    own = ["trained"] if is_task(target) else []
    first = policy or (own[0] if own else None)
    if first is not None:
        choose("policy", first, [*own, *SCRIPTED])

    def casting(choice):
        """A scripted team plays in the environment of the one that was asked for."""
        ...

    raise NotImplementedError
