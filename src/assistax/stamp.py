"""Where a result comes from: versions, commit, hardware."""

import hashlib
import math
import os
import platform
import resource
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("assistax", "jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "numpy", "optax")


@cache
def stamp() -> dict[str, Any]:
    """{"versions", "commit", "source", "hardware"} of this process."""
    return {"versions": versions(), "commit": commit(), "source": source_hash(), "hardware": hardware()}


def stamp_changes(then: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """In words, what a stamp has that another has not: "mujoco 3.17.0, now 3.18.0". Hardware may differ."""
    source = [name for name in ("source", "commit") if name in then][:1]  # the source, where both know it
    there, here = (one.get("versions", {}) | {name: one.get(name) for name in source} for one in (then, now))
    return [f"{name} {there[name]}, now {here.get(name)}" for name in there if there[name] != here.get(name)]


def versions() -> dict[str, str]:
    """Of Python and, as far as they are installed, of PACKAGES."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


@cache
def source_hash() -> str:
    """SHA-256, in short, of the package's own code and models: the same at every commit that does not change them."""
    root, total = Path(__file__).parent, hashlib.sha256()
    for path in sorted((*root.rglob("*.py"), *root.rglob("*.xml"))):
        total.update(f"{path.relative_to(root).as_posix()}\0".encode() + path.read_bytes())
    return total.hexdigest()[:16]


def commit() -> str | None:
    """The git commit this package is checked out at, with "+" if files differ; None if installed.

    A package that is installed somewhere inside another repository, as in a virtual environment, is not of that one's
    commits: this file has to be one of its files.
    """
    here = Path(__file__)

    def git(*args):
        command = ["git", "-C", str(here.parent), *args]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", here.name)
        dirty = "+" if git("status", "--porcelain", "--", ".") else ""
        return git("rev-parse", "--short=12", "HEAD") + dirty
    except (OSError, subprocess.CalledProcessError):
        return None


def hardware() -> str:
    """The accelerator JAX uses, or the CPU."""
    import jax

    device = jax.devices()[0]
    if device.platform != "cpu":
        return f"{len(jax.devices())} x {device.device_kind}"
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [line.split(":")[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        name = models[0] if models else name
    elif sys.platform == "darwin":
        query = ["sysctl", "-n", "machdep.cpu.brand_string"]
        name = subprocess.run(query, capture_output=True, text=True, check=False).stdout.strip() or name
    return f"{os.cpu_count()} cores, {name}"


def memory_gb() -> float:
    """The memory that JAX's arrays can have, in GB: the accelerator's, or on a CPU all of the machine's."""
    import jax

    device = jax.devices()[0]
    if device.platform == "cpu":
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    return (device.memory_stats() or {}).get("bytes_limit", math.inf) / 1e9


def peak_memory_mb() -> float:
    """The most memory so far, in MiB: of the accelerator's that JAX has used, on a CPU this process's resident size."""
    import jax

    if "peak_bytes_in_use" in (stats := jax.devices()[0].memory_stats() or {}):
        return stats["peak_bytes_in_use"] / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
