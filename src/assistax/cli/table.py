"""`assistax table`."""

from assistax.cli.common import Json, Runs, Switch, aligned, print_json
from assistax.errors import UsageError


def table(runs: Runs = (), *, compare: Switch = False, markdown: Switch = False, json: Json = False) -> None:
    """Tabulate the results of finished runs, with 95 % intervals over their seeds.

    Runs that differ in nothing but seeds are one row. Below it, for each algorithm with several tasks, the
    interquartile mean of normalised returns: by the paper's bound, by the expert's return, and between the worst and
    the best scripted policy (results/experts.json); and success, safe success and cost. When 90 % of an evaluation's
    episodes were first a success is asked of safe success, where a run has that.

    For example:
      assistax table
      assistax table runs/scratch-ippo-0 runs/scratch-mappo-0 --compare
      assistax table results --json > results/table.json

    Args:
      runs: run folders, or folders of finished ones, at any depth (default: results and runs). Sub-folders trials
        and ablations hold what was tried on the way and count only if they are named.
      compare: also how probable it is that one algorithm beats another.
      markdown: print Markdown.
      json: print JSON, with seeds, commits, versions and hardware.
    """
    from assistax.results.comparison import markdown as as_markdown
    from assistax.results.comparison import read_references, report, tables
    from assistax.results.stored import experiments, find_runs

    if json and markdown:
        raise UsageError("Choose one of --json and --markdown.")
    results = report(experiments(find_runs(runs)), read_references(), compare)
    if json:
        print_json(results)
        return
    print("\n\n".join((as_markdown if markdown else aligned)(*each) for each in tables(results)))
    for remark in results["remarks"]:
        print(f"\n{remark}")
