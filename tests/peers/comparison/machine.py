"""The machine, the versions, and what the machine can do at most."""

import datetime
import importlib.metadata
import os
import pathlib
import platform
import re
import subprocess

import numpy as np

from .progress import note
from .timing import timed

LIBRARIES = ("numpy", "scipy", "scikit-learn")
# Where there is no word of the caches.
CACHES = {2: 1 << 20, 3: 16 << 20}
# Arrays that are to come from memory are so many times as large as the last cache, at least.
BEYOND = 8
LEAST = 256 << 20
SIDE = 1024
TRIES = 9


def processor():
    text = pathlib.Path("/proc/cpuinfo").read_text(encoding="utf-8")
    found = re.search(r"^model name\s*:\s*(.*)$", text, re.MULTILINE)
    vectors = "AVX-512" if "avx512f" in text else "AVX2" if "avx2" in text else "no AVX2"
    return f"{found.group(1) if found else platform.machine()}, {vectors}"


def caches():
    """Bytes of the caches of a core by level; the last one may be shared."""
    sizes = dict(CACHES)
    for folder in pathlib.Path("/sys/devices/system/cpu/cpu0/cache").glob("index*"):
        kind = (folder / "type").read_text(encoding="ascii").strip()
        size = (folder / "size").read_text(encoding="ascii").strip()
        if kind != "Instruction" and size.endswith("K"):
            sizes[int((folder / "level").read_text(encoding="ascii"))] = int(size[:-1]) << 10
    return sizes


def said(*command):
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError) as error:
        return f"unknown ({error})"


def rust_libraries(manifest):
    lock = manifest.with_name("Cargo.lock").read_text(encoding="utf-8")
    versions = re.findall(r'name = "(faer|linfa|linfa-clustering)"\nversion = "([^"]+)"', lock)
    return dict(versions)


def describe(manifest, command):
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    versions = {name: importlib.metadata.version(name) for name in LIBRARIES}
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    return {
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "memory": memory,
        "kernel": f"{platform.system()} {platform.release()}",
        "rustc": said("rustc", "--version"),
        "python": platform.python_version(),
        "blas": f"{blas['name']} {blas['version']}",
        "versions": versions | rust_libraries(manifest),
        "commit": said("git", "-C", str(manifest.parent), "describe", "--always", "--dirty"),
        "date": datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        "load": os.getloadavg()[0],
        "command": command,
    }


def limits(ours):
    """Bytes and operations per second of one thread."""
    note("limits of the machine")
    sizes = caches()
    last = sizes[max(sizes)]
    # Half of a cache, as something else needs room too; a shared one is not ours alone.
    arrays = {"L2": sizes[2] // 2, "L3": min(sizes[3] // 4, 8 << 20), "DRAM": max(BEYOND * last, LEAST)}
    found = {f"triad {name}": ours.ask("triad", bytes=size)["value"] for name, size in arrays.items()}
    found["gemm faer"] = ours.ask("gemm")["value"]
    a = np.arange(SIDE * SIDE, dtype=np.float64).reshape(SIDE, SIDE) / SIDE**2
    best = min(timed(lambda: a @ a)[0]["cpu"] for _ in range(TRIES))
    found["gemm BLAS"] = 2.0 * SIDE**3 / best
    found["single gemm"] = ours.ask("single_gemm")["value"]
    found["roots"] = ours.ask("roots")["value"]
    return found


def sharing(ours):
    """How many times as much two threads do as one, and how long one waits for the other."""
    sizes = caches()
    arrays = {"triad L2": sizes[2] // 2, "triad DRAM": max(BEYOND * sizes[max(sizes)], LEAST), "gemm": None}
    found = {name: ours.ask("two_threads", bytes=size)["value"] for name, size in arrays.items()}
    return {"gains": found, "hand over": ours.ask("hand_over")["value"]}
