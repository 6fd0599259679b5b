"""Does the comparison of the step with C notice a missing term? Drop one at a time, in C and in the compiled step.

    python benchmarks/step_mutants.py [--only c|compiled] [--count N] [--case CASE ...]

A copy of rths_step.c, or of the package, lacks one term; both steps play the samples of shipped cases until one
differs. Printed: each term and what differed. Exit code 1 where one was not noticed. All mutants play the blocks that
the unchanged program designed. To compile a mutant of the compiled step takes a minute, so that its sources are
interpreted (tests/helpers/campaigns/interpreted.py) over the first FEW_STEPS of each case.
"""

from __future__ import annotations

import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

TREE = Path(__file__).parents[1]
HELPERS = TREE / "tests" / "helpers"
sys.path[:0] = [str(TREE), str(HELPERS)]  # the sources this file belongs to

import numpy as np  # noqa: E402
from campaigns.exported_step import EQUAL, SOURCES, both, differences, shipped  # noqa: E402
from options import arguments, parsed  # noqa: E402

from rths_cli.experiment.designed_step import DesignedStep  # noqa: E402
from rths_cli.experiment.model_choice import Memory  # noqa: E402
from rths_cli.experiment.model_files import Cache  # noqa: E402
from rths_cli.loop.recorded_steps import Recorded  # noqa: E402

SOURCE = SOURCES / "rths_step.c"
Given = tuple[DesignedStep, Recorded]
SHORT = ("--only", "c", "--count", "2", "--case", "el_centro_low_ff_fb")
PRINTS = "2 of 2 missing terms noticed"  # the short form at its end

UNNOTICED = "NOT NOTICED"
SAME = 1e-10  # of a signal's peak
FEW_STEPS = 3000
LOST = (1500, 1600, 1601, 1602, 2000, 2001, 2003)  # samples that are lost in every case
CASES = ("el_centro_low_ff_fb", "el_centro_viscous_damper", "hachinohe_low_ff_fb")
IN_C = {  # what is dropped: text of rths_step.c, what stands there instead
    "friction's tanh": ("tanh(velocity * rths_data.per_scale) - ", "0.0 - "),
    "friction's linear part": (" - rths_data.linear_s_per_m * velocity)", ")"),
    "lead of the velocity for friction": (" + rths_data.lead_s * motion[0]", ""),
    "reaction of the specimen": ("given[3 + c] = corrected_of(s)[c]", "given[3 + c] = 0.0"),
    "feedback's part of the command": ("shape(s, s->forward_v + s->back_v)", "shape(s, s->forward_v)"),
    "rounding carried over": ("command + s->carried", "command"),
    "alias of the command's change": ("rths_data.ripple_m_s2_per_v * (now - before) + ", ""),
    "alias of the commands' sum": (" + rths_data.ripple_sum_m_s2_per_v * (now + before)", ""),
    "second state of the sensors' correction": ("  given[1] = sum[1];\n", ""),
    "recent accelerations in the interface force": ("s->force += rths_data.force_recent[k] * s->recent[k];", ";"),
    "returned interface force": ("  s->force += rths_data.force_returned * free_accel;\n", "  (void)free_accel;\n"),
    "direct acceleration by force": (" + rths_data.direct * s->force", ""),
    "ground motion in the absolute motion": ("row == 0 ? value : value + ground[row]", "value + 0.0 * ground[row]"),
    "second state of the storeys' modes": (" + rths_data.turn[1][i] * second", ""),
    "interface force in the storeys": ("  s->columns[RTHS_COLUMNS - 1] = s->force;\n", ""),
    "measured motion in the tracking error": ("s->recent[0] - corrected[RTHS_MEASURED_BY]", "s->recent[0]"),
    "share of the ramp-up": ("  s->command *= s->share;\n", ""),
    "substituted samples": ("    s->gap_now++;\n    bridge(s);", "    s->gap_now++;"),
    "samples that return slowly": ("+= share * (s->came[c] - s->samples[c])", "= s->came[c]"),
    "zeros of the channels": ("signs[c] * (in->samples_v[c] - s->zeros_v[c])", "signs[c] * in->samples_v[c]"),
}  # fmt: skip
COMPILED = {  # what is dropped: file below rths_cli/loop, its text, what stands there instead
    "friction's tanh": ("linear_parts.py", "(sign - self", "(0.0 - self"),
    "friction's linear part": ("linear_parts.py", "(sign - self.linear_s_per_m * velocity)", "sign"),
    "lead of the velocity for friction": ("linear_parts.py", " + self.lead_s * motion[0, 0]", ""),
    "reaction of the specimen": ("linear_parts.py", "[first + c] = corrected[c]", "[first + c] = 0.0"),
    "feedback's part of the command": ("step.py", "s.forward[a] + s.back[a])", "s.forward[a])"),
    "rounding carried over": ("step.py", "wanted = command + s.carried[a]", "wanted = command"),
    "alias of the command's change": ("step.py", "s.ripple_m_s2_per_v * (now - before) + ", ""),
    "alias of the commands' sum": ("step.py", " + s.ripple_sum_m_s2_per_v * (now + before)", ""),
    "correction of the alias": ("step.py", "[s.measured_by[i]] -= staircase_of(s, i)", "[s.measured_by[i]] -= 0.0"),
    "state of the sensors' correction": ("linear_parts.py", "= last, before, total", "= last, 0.0, total"),
    "recent accelerations in the interface force": ("step.py", "s.force_recent[i, k, j] * s", "0.0 * s"),
    "returned interface force": ("step.py", "s.force_returned[i, j] * s", "0.0 * s"),
    "direct acceleration by force": ("step.py", "direct[i, j] * s", "0.0 * s"),
    "ground motion in the absolute motion": ("storey_forces.py", "[q, i] = value if q == 0 else value + ground[q]",
                                             "[q, i] = value"),
    "second state of the storeys' modes": ("storey_forces.py", "self.turn[1, i] * second + inputs", "inputs"),
    "interface force in the storeys": ("storey_forces.py", " + self.drive[1, 1, i] * force[0]", ""),
    "desired motion that goes on": ("step.py", "recent[k, i] = recent[k + 1, i] + 0.0", "recent[k, i] += 0.0"),
    "measured motion in the tracking error": ("step.py", "[0, i] - s.corrected[s.measured_by[i]]", "[0, i]"),
    "commands that were sent": ("step.py", "s.sent[i, a] = s.sent[i - 1, a] + 0.0", "s.sent[i, a] += 0.0"),
    "samples that return slowly": ("fallback_commands.py", "s.samples[c] += share * (r.came[c] - s.samples[c])",
                                   "s.samples[c] = r.came[c]"),
}  # fmt: skip


def dropped(text: str, old: str, new: str, where: str) -> str:
    """Return a source without a term; raises ValueError where the term is not there exactly once."""
    if text.count(old) != 1:
        raise ValueError(f"{where}: {old!r} stands there {text.count(old)} times: adapt this file")
    return text.replace(old, new)


def prepared(memory: Memory, case: str) -> Given:
    """Return the step of a case and the samples of its run, some of which are lost, with zeros and a shaken ramp-up."""
    step, given = shipped(memory, case)
    zeros_v, came = 1e-3 * (1.0 + np.arange(given.samples_v.shape[1])), given.came.copy()
    came[list(LOST)] = False
    samples_v = given.samples_v + zeros_v
    samples_v[given.still : given.still + given.ramp, 1:] += 0.01
    return step, replace(given, samples_v=samples_v, zeros_v=zeros_v, came=came)


def first_steps(given: Given) -> Given:
    """Return the first FEW_STEPS of a run."""
    step, one = given
    return step, replace(one, samples_v=one.samples_v[:FEW_STEPS], came=one.came[:FEW_STEPS], stop=one.stop[:FEW_STEPS])


def noticed(source: str | None, given: Path, folder: Path) -> str:
    """Return what differs first between this process's step and the C of a source, on the inputs in a file."""
    for case, (step, samples) in pickle.loads(given.read_bytes()).items():
        if found := list(differences(*both(step, samples, folder, EQUAL, source), SAME)):
            return f"{case}: {found[0]}"
    return UNNOTICED


def in_c(name: str, given: Path, folder: Path) -> str:
    """Return what shows that rths_step.c lacks a term."""
    return noticed(dropped(SOURCE.read_text(encoding="utf-8"), *IN_C[name], SOURCE.name), given, folder)


def in_compiled(name: str, given: Path, folder: Path) -> str:
    """Return what shows that the compiled step lacks a term: a copy of the package plays in a process of its own."""
    file, old, new = COMPILED[name]
    shutil.copytree(TREE / "rths_cli", folder / "rths_cli", ignore=shutil.ignore_patterns("__pycache__"))
    path = folder / "rths_cli" / "loop" / file
    path.write_text(dropped(path.read_text(encoding="utf-8"), old, new, file), encoding="utf-8")
    code = (
        f"import sys; sys.path[:0] = {[str(folder), str(HELPERS), str(Path(__file__).parent)]!r}; import rths_cli\n"
        "from campaigns import interpreted\n"
        f"assert rths_cli.__file__.startswith({str(folder)!r})\n"
        "from pathlib import Path; import step_mutants\n"
        f"print(step_mutants.noticed(None, Path({str(given)!r}), Path({str(folder)!r})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{name}: {done.stderr[-2000:]}")
    return done.stdout.splitlines()[-1]


def told(kind: str, names: Sequence[str], given: Path) -> Iterator[bool]:
    """Print what each missing term showed, and yield whether it was noticed."""
    for name in names:
        with tempfile.TemporaryDirectory(prefix="rths-mutant-") as folder:
            found = (in_c if kind == "c" else in_compiled)(name, given, Path(folder))
        print(f"{kind}, without {name}: {found}", flush=True)
        yield found != UNNOTICED


def main() -> int:
    """Drop every term; return 1 where one was not noticed."""
    parser = arguments(__doc__)
    parser.add_argument("--only", choices=("c", "compiled"))
    parser.add_argument("--count", type=int, help="of the first terms of each")
    parser.add_argument("--case", nargs="+", default=CASES)
    asked = parsed(parser, SHORT)
    for file, *term in COMPILED.values():
        dropped((TREE / "rths_cli" / "loop" / file).read_text(encoding="utf-8"), *term, file)
    for term in IN_C.values():
        dropped(SOURCE.read_text(encoding="utf-8"), *term, SOURCE.name)
    memory = Memory(Cache())
    with tempfile.TemporaryDirectory(prefix="rths-mutants-") as name:
        given, few = Path(name) / "inputs", Path(name) / "few"
        inputs = {case: prepared(memory, case) for case in asked.case}
        given.write_bytes(pickle.dumps(inputs))
        few.write_bytes(pickle.dumps({case: first_steps(one) for case, one in inputs.items()}))
        if (found := noticed(None, given, Path(name))) != UNNOTICED:
            print(f"without a change: {found}")
            return 1
        kinds = {"c": list(IN_C), "compiled": list(COMPILED)}
        results = [
            one for kind, names in kinds.items() if asked.only in (None, kind)
            for one in told(kind, names[: asked.count], given if kind == "c" else few)
        ]  # fmt: skip
    print(f"{results.count(True)} of {len(results)} missing terms noticed")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
