"""Hand-written run directories, as runs leave them: trials in any state, plans, progress."""

import hashlib
import json
import subprocess
import sys
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

from meshfit.config.experiment import default_settings
from meshfit.config.strict_yaml import dump
from meshfit.measuring.metrics import METRICS
from meshfit.mesh.targets import NAMED_TARGETS
from meshfit.settings import deep_merge

NOW = datetime(2026, 5, 4, 12, 0, 0, tzinfo=UTC)


def identity_of(*facts):
    return hashlib.sha256(repr(facts).encode()).hexdigest()


def place(target="bunny", scheme="loop", seed=0, experiment="small"):
    """A trial's folder below its run directory."""
    digits = identity_of(experiment, target, scheme, seed)[:10]
    return Path(experiment, target, scheme.replace(":", "-").replace("=", "-"), f"seed-{seed}-{digits}")


# Measures of results whose places are known, which tables lead with where there are any.
_OF_TEMPLATES = ("vertex_error", "landmark_error")


def settings_of(target="bunny", scheme="loop", seed=0, **fit):
    plain = default_settings(fit.get("method", "first-order"))
    return deep_merge(plain, {"targets": [target], "schemes": [scheme], "seeds": [seed], "fit": fit})


def result_of(target="bunny", scheme="loop", seed=0, experiment="small", fit_seconds=10.0, measure_seconds=1.0, **fit):
    settings = settings_of(target, scheme, seed, **fit)
    figures = {}
    for name, metric in METRICS.items():
        group, _, key = name.partition(".")
        if group in _OF_TEMPLATES:
            continue
        value = {"d": 3 + seed, "": True, ".4f": min(0.1 + seed / 30, 1.0)}.get(metric.format, 0.1 + seed / 3)
        figures.setdefault(group, {})[key] = value
    return {
        "schema_version": 2,
        "identity": identity_of(experiment, target, scheme, seed),
        "experiment": experiment,
        "target": target,
        "target_title": f"the {target}",
        "scheme": scheme,
        "seed": seed,
        **figures,
        "fit": {"steps": settings["fit"].get("steps", 90), "device": "cpu", "final_loss": 0.5},
        "frame": {"centre": [0.0, 1.0, 2.0], "scale": 0.5, "normalise": "tutorial", "written": "normalised"},
        "inputs": {"target": NAMED_TARGETS[target].sha256 if target in NAMED_TARGETS else "ab" * 32},
        "settings": settings,
        "seconds": {"fit": fit_seconds, "measure": measure_seconds},
        "peak_memory_mb": 400.5,
        "warnings": ["one, of\ntwo lines"] if seed == 1 else [],
        "versions": {"python": "3.11.7", "meshfit": "0.1.0"},
        "platform": {"system": "Linux", "machine": "x86_64"},
    }


def begun(runs, **names):
    """A folder in which a trial was begun, and the checkpoint that it left."""
    folder = runs / place(**names)
    folder.mkdir(parents=True)
    (folder / ".lock").touch()
    (folder / "source.ply").write_text("ply")
    named = {key: value for key, value in names.items() if key != "experiment"}
    (folder / "config.yaml").write_text(dump(settings_of(**named)))
    (folder / "checkpoint.pt").write_bytes(b"x" * 100)
    return folder


def complete(runs, target="bunny", scheme="loop", seed=0, experiment="small", **facts):
    folder = begun(runs, target=target, scheme=scheme, seed=seed, experiment=experiment)
    (folder / "checkpoint.pt").unlink()
    (folder / "result.ply").write_text("ply")
    (folder / "result.json").write_text(json.dumps(result_of(target, scheme, seed, experiment, **facts)))
    return folder


def failed(runs, kind="diverged", message="the fit diverged at step 7", step=7, **names):
    folder = begun(runs, **names)
    (folder / "checkpoint.pt").unlink()
    (folder / "trial.log").write_text("step 7\n")
    record = {"kind": kind, "message": message, "step": step, "attempts": 1, "log": "trial.log", "error": "Diverged"}
    (folder / "failure.json").write_text(
        json.dumps(record | {"identity": folder.name.rpartition("-")[2].ljust(64, "0")})
    )
    return folder


def write_plan(experiment, trials, workers=2, steps=2000, **changes):
    """The plan of an experiment; `trials` are the names of each, as `place` takes them."""
    rows = []
    for names in trials:
        full = {"target": "bunny", "scheme": "loop", "seed": 0, "experiment": experiment.name} | names
        full.pop("variant", None)
        where = place(**full)
        rows.append(
            {"folder": str(where.relative_to(where.parts[0])), "identity": identity_of(*_ordered(full))}
            | {"target": full["target"], "target_title": f"the {full['target']}", "scheme": full["scheme"]}
            | {"seed": full["seed"], "variant": names.get("variant", ""), "steps": steps}
        )
    experiment.mkdir(parents=True, exist_ok=True)
    plan = {"schema_version": 1, "written": NOW.isoformat(), "workers": workers, "trials": rows} | changes
    (experiment / "plan.json").write_text(json.dumps(plan))


def _ordered(names):
    return names["experiment"], names["target"], names["scheme"], names["seed"]


def write_progress(folder, silent=1.0, running=100.0, now=NOW, **changes):
    """A sign of life so many seconds old, of an attempt that had run for so many seconds by then."""
    updated = now - timedelta(seconds=silent)
    started = updated - timedelta(seconds=running)
    said = {"phase": "fitting", "step": 500, "steps": 2000, "loss": 0.0123, "host": "node7", "pid": 4711}
    said |= {"started": started.isoformat(), "updated": updated.isoformat()} | changes
    (folder / "progress.json").write_text(json.dumps(said))


@contextmanager
def held(*folders):
    """Locks that another process holds until the end of the block, where it is killed."""
    code = "import sys, time; from filelock import FileLock; locks = [FileLock(p) for p in sys.argv[1:]]\n"
    code += "[lock.acquire() for lock in locks]; print('held', flush=True); time.sleep(600)"
    names = [str(folder / ".lock") for folder in folders]
    with subprocess.Popen([sys.executable, "-c", code, *names], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()
