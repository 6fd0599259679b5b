"""Does the comparison of the step with C notice a missing term? Drop one at a time, in C and in the compiled step.

    python benchmarks/step_mutants.py [--only c|compiled] [--count N] [--case CASE ...]

A copy of step.c, or of the package, lacks one term; both steps play the shipped cases of tests/loop/test_against_c.py
until one differs. Printed: each term and what differed. Exit code 1 where one was not noticed. All mutants play the
blocks that the unchanged program designed. To compile a mutant of the compiled step takes a minute, so that its sources
are interpreted (tests/helpers/campaigns/interpreted.py) over the first FEW_STEPS of each case.
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

from campaigns import step_in_c, step_run  # noqa: E402
from campaigns.step_comparison import SHIPPED, both, differences  # noqa: E402
from options import arguments, parsed  # noqa: E402

from rths_cli.experiment.model_choice import Memory  # noqa: E402
from rths_cli.experiment.model_files import Cache  # noqa: E402

SHORT = ("--only", "c", "--count", "2", "--case", "el_centro_low_ff_fb")
PRINTS = "2 of 2 missing terms noticed"  # the short form at its end

UNNOTICED = "NOT NOTICED"
FEW_STEPS = 3000
IN_C = {  # what is dropped: text of step.c, what stands there instead
    "friction's tanh": ("tanh(velocity * f->per_scale) - ", "0.0 - "),
    "friction's linear part": (" - f->linear_s_per_m * velocity)", ")"),
    "lead of the velocity for friction": (" + f->lead_s * motion[0]", ""),
    "reaction of the specimen": ("= s->corrected.at[c]; /* the specimen's reaction */", "= 0.0;"),
    "feedback's part of the command": ("shape(s, a, forward + applied)", "shape(s, a, forward)"),
    "rounding carried over": ("command + s->carried.at[a]", "command"),
    "alias of the command's change": ("s->ripple_m_s2_per_v * (now - before) + ", ""),
    "alias of the commands' sum": (" + s->ripple_sum_m_s2_per_v * (now + before)", ""),
    "second state of the sensors' correction": (" + *(const v4 *)(matrix + 4) * given[1]", ""),
    "recent accelerations in the interface force": ("force[i] += s->force_recent", "force[i] += 0.0 * s->force_recent"),
    "returned interface force": ("force[i] += s->force_returned", "force[i] += 0.0 * s->force_returned"),
    "direct acceleration by force": ("free_accel[i] += b->direct", "free_accel[i] += 0.0 * b->direct"),
    "ground motion in the absolute motion": ("value + drive[row / n]", "value"),
    "second state of the storeys' modes": (" + turn[m + i] * two", ""),
    "interface force in the storeys": (" + into[3 * m + i] * force[0]", ""),
    "measured motion of the expected floors": ("i ? s->corrected.at[0] : s->recent.at[0]", "s->recent.at[0]"),
    "measured motion in the tracking error": ("other[i] - s->corrected.at[s->measured_by[i]]", "other[i]"),
    "AC coupling of the sensors": ("s->low.at[c] - s->coupled.at[c] + ", "s->low.at[c] + "),
    "noise of the sensors": (" + p->noise_rms_m_s2 * noise[c]", ""),
    "friction when the table's sign is saturated": (" || fabs(ratio) > saturated) return", ") return"),
}
COMPILED = {  # what is dropped: file below rths_cli/loop, its text, what stands there instead
    "friction's tanh": ("friction_feedforward.py", "(sign - self", "(0.0 - self"),
    "friction's linear part": ("friction_feedforward.py", "(sign - self.linear_s_per_m * velocity)", "sign"),
    "lead of the velocity for friction": ("friction_feedforward.py", " + self.lead_s * motion[0, 0]", ""),
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
    "ground motion in the absolute motion": ("modal_substructure.py", "value + ground[q]", "value"),
    "second state of the storeys' modes": ("modal_substructure.py", " + self.turn[1, i] * second", ""),
    "interface force in the storeys": ("modal_substructure.py", " + self.drive[1, 1, i] * force[0]", ""),
    "desired motion that goes on": ("step.py", "recent[k, i] = recent[k + 1, i] + 0.0", "recent[k, i] += 0.0"),
    "measured motion of the expected floors": ("step.py", "s.corrected[0], s", "s.recent[0, 0], s"),
    "measured motion in the tracking error": ("step.py", "[0, i] - s.corrected[s.measured_by[i]]", "[0, i]"),
    "commands that were sent": ("step.py", "s.sent[i, a] = s.sent[i - 1, a] + 0.0", "s.sent[i, a] += 0.0"),
}  # fmt: skip


def dropped(text: str, old: str, new: str, where: str) -> str:
    """Return a source without a term; raises ValueError where the term is not there exactly once."""
    if text.count(old) != 1:
        raise ValueError(f"{where}: {old!r} stands there {text.count(old)} times: adapt this file")
    return text.replace(old, new)


def first_steps(given: step_run.Inputs) -> step_run.Inputs:
    """Return the inputs of the first FEW_STEPS."""
    return replace(given, drive=given.drive[:FEW_STEPS].copy(), noise=given.noise[: FEW_STEPS + 1].copy())


def noticed(source: Path, given: Path, folder: Path) -> str:
    """Return what differs first between this process's step and the C of a source, on the inputs in a file."""
    library = step_in_c.compiled(folder, source)
    for case, inputs in pickle.loads(given.read_bytes()).items():
        if found := list(differences(*both(library, inputs))):
            return f"{case}: {', '.join(found)}"
    return UNNOTICED


def in_c(name: str, given: Path, folder: Path) -> str:
    """Return what shows that step.c lacks a term."""
    source = folder / "step.c"
    source.write_text(dropped(step_in_c.SOURCE.read_text(encoding="utf-8"), *IN_C[name], "step.c"), encoding="utf-8")
    return noticed(source, given, folder)


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
        "from pathlib import Path; import step_mutants; from campaigns import step_in_c\n"
        f"print(step_mutants.noticed(step_in_c.SOURCE, Path({str(given)!r}), Path({str(folder)!r})))"
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
    parser.add_argument("--case", nargs="+", default=SHIPPED)
    asked = parsed(parser, SHORT)
    for file, *term in COMPILED.values():
        dropped((TREE / "rths_cli" / "loop" / file).read_text(encoding="utf-8"), *term, file)
    for term in IN_C.values():
        dropped(step_in_c.SOURCE.read_text(encoding="utf-8"), *term, "step.c")
    memory = Memory(Cache())
    with tempfile.TemporaryDirectory(prefix="rths-mutants-") as name:
        given, few = Path(name) / "inputs", Path(name) / "few"
        inputs = {case: step_run.inputs(*step_run.prepared(memory, case)) for case in asked.case}
        given.write_bytes(pickle.dumps(inputs))
        few.write_bytes(pickle.dumps({case: first_steps(one) for case, one in inputs.items()}))
        if (found := noticed(step_in_c.SOURCE, given, Path(name))) != UNNOTICED:
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
