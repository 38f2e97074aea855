"""Say what is installed, what would be used and whether it works."""

import time
from typing import Any

from assistax.errors import AssistaxError
from assistax.stamp import stamp


def diagnose() -> dict[str, Any]:
    """{"versions", ..., "engine", "rendering", "self_test"}, each in words."""
    import jax

    from assistax.physics import resolve_engine

    engine, why = resolve_engine("auto")
    checks = {"engine": _steps, "rendering": _renders}
    results = {name: _attempt(check) for name, check in checks.items()}
    return {
        **stamp(),
        "jax_devices": ", ".join(str(device) for device in jax.devices()),
        "engine": f"auto takes {engine!r}, because {why}",
        "self_test": results["engine"],
        "rendering": results["rendering"],
    }


def _attempt(check) -> str:
    try:
        return check()
    except AssistaxError as error:
        return f"FAILED: {error}"
    except Exception as error:  # a broken installation can fail in any way; say how
        return f"FAILED: {type(error).__name__}: {str(error).splitlines()[0]}"


def _steps() -> str:
    """Two seconds of scratch with a still team."""
    from assistax.env import make
    from assistax.evaluation.playing import evaluate
    from assistax.policies import scripted_team

    began = time.perf_counter()
    env = make("scratch", episode_length=250)
    result = evaluate(env, scripted_team("still", env), episodes=8)
    took = time.perf_counter() - began
    return f"ok: 8 x 2 s of scratch in {took:.1f} s with compilation, mean return {result['mean_return']:.1f}"


def _renders() -> str:
    import os

    from assistax.evaluation.film import Camera

    began = time.perf_counter()
    with Camera("scratch", 160, 120) as camera:
        picture = camera.picture(camera.model.key("start").qpos, camera.data.mocap_pos[0])
    if picture.std() < 1:
        return "FAILED: the picture is blank"
    backend = os.environ.get("MUJOCO_GL", "the system's default")
    return f"ok: {backend}, first picture after {time.perf_counter() - began:.1f} s"
