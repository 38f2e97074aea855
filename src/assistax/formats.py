"""What must be in the files that the program reads back, as schemas (see files.py); more may be."""

from typing import Any

from assistax.files import Schema

SEEDS = range(2**32)
COUNT = range(1, 2**31)
STEPS = range(2**53)

STAMP: Schema = {"versions?": {str: str}, "commit?": (str, None), "source?": str, "hardware?": str}
_PERSON: Schema = {str: str}

# config.json of a run, "config" in sweep.json, "team" in a team file. Other settings are checked by their dataclasses.
CONFIG: Schema = {
    "task": str,
    "algorithm": str,
    "preset": str,
    "steps": range(1, 2**53),
    "seed": SEEDS,
    "num_envs?": COUNT,
    "num_seeds?": range(1, 10**4),
    "start?": str,
    "partners?": [str],
    "partner_copies?": [str],
    "env?": {"human?": {"disability?": str, "preference?": str, "people?": (str, [_PERSON])}},
    "task_config?": {str: object},
    "ppo?": {"recurrent?": bool, "share_parameters?": bool},
    "sac?": {str: object},
    "stamp?": STAMP,
    "resumed?": [{"steps": STEPS, "stamp": STAMP}],
}

_MEAN: Schema = {"mean": float}
EVALUATION: Schema = {  # what `evaluation.summarize` returned
    "episodes": COUNT,
    "mean_return": float,
    "success_rate": float,
    "task_return?": _MEAN,
    "preference_return?": _MEAN,
    "force": {str: float},
    "outcomes": {str: _MEAN},
}
SUMMARY: Schema = {"evaluation": [EVALUATION], "steps?": STEPS, "engine?": str} | STAMP

ROWS: dict[str, Any] = {  # of evaluations.jsonl and metrics.jsonl
    "evaluations": {"steps": STEPS, "seed": SEEDS, "episodes": {str: [float]}},
    "metrics": {"steps": STEPS, "seed": SEEDS, "episodes": STEPS, "episode": {str: float}, "reward": {str: float}},
}

MEMBER: Schema = {  # a row of a population's manifest.jsonl
    "id": str,
    "task": str,
    "algorithm": str,
    "architecture": str,
    "row": range(10**6),
    "seed": SEEDS,
    "steps": STEPS,
    "person": _PERSON,
    "robot": bool,
    "habit?": str,
    "taught?": str,
    "fraction?": float,
    "mean_return?": float,
    "success_rate?": float,
    "safe_success_rate?": float,
}
SEAL: Schema = {"members": COUNT, "sha256": str}  # of a population's manifest: its population.json
PLAN: Schema = {  # of a population, see teamwork/plan.py
    "task": str,
    "people": [_PERSON],
    "algorithms": [str],
    "seeds": range(1, 10**6),
    "steps": (STEPS, None),
    "num_envs": (COUNT, None),
    "settings": {str: object},
    "taught?": [str],
}
BEST_RESPONSES: Schema = {"task": str, "steps": (STEPS, None), "settings": {str: object}}
SPLIT: Schema = {"train": [str], "val": [str], "test": [str]}
VALIDITY: Schema = {"ids": [str], "matrix": {"return": [[float]]}}  # and more, see teamwork/validity.py
_PARTS: Schema = {"train": [{str: str}], "test": [{str: str}]}
TEAMWORK: Schema = {"task": str, "people": _PARTS, "gap": {str: object}}  # and more, see teamwork/report.py
EXPERTS: Schema = [{"task": str, "policy": str, "human": _PERSON, "mean_return": float}]
PEOPLE: Schema = [_PERSON]

_SETTING: Schema = (str, bool, float, None, [float])
_SWEEP_CONFIG: Schema = CONFIG | {"stamp": {"versions": {str: str}, "commit": (str, None)}}
SWEEP: Schema = {"config": _SWEEP_CONFIG, "search": {str: str}, "drawn": [{str: _SETTING}], "side_by_side?": COUNT}
TRIAL: Schema = {
    "config": STEPS,
    "seed": SEEDS,
    "settings": {str: _SETTING},
    "steps": STEPS,
    "auc": (float, None),
    "final_return": (float, None),
    "success": (float, None),
    "failed": bool,
}

CHECKPOINT: Schema = {
    "task": str,
    "algorithm": str,
    "steps": STEPS,
    "seconds": {str: float},
    "settings?": {str: object},
}
TEAM: Schema = {"team": CONFIG, "measured?": {str: object}}
PARTNER: Schema = {"partner": CONFIG, "members": range(1, 10**4), "deterministic": bool}  # a run's copy of it
UNFINISHED: Schema = {"trials": [[STEPS]], "points": [[[object]]], "seconds": {str: float}}  # trials of a sweep
