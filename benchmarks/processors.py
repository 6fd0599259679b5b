"""Run the tests as other processors would: compiled code, BLAS kernels, numpy and the C library for each of them.

python benchmarks/processors.py [--only NAME] [PYTEST ARGUMENT...]    all tests, generic, haswell, skylake-avx512, zen

An instruction set that this machine lacks cannot be run: skylake-avx512 is then tuned for but held to what there is.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from options import arguments, words

SHORT = ("--only", "generic", "--version")
PRINTS = "passed on each"  # the short form at its end

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Processor:
    """A processor by the names that numba, OpenBLAS, numpy and the C library know it by.

    `lacks`: words in the names of numpy's instruction sets that it does not have; `hidden`: the C library's.
    """

    numba: str
    openblas: str
    lacks: tuple[str, ...]
    hidden: tuple[str, ...]


WIDE = ("AVX512", "X86_V4")
PROCESSORS = {
    "generic": Processor("generic", "Prescott", ("",), ("AVX512F", "AVX2", "AVX", "FMA", "FMA4", "BMI2")),
    "haswell": Processor("haswell", "Haswell", WIDE, ("AVX512F", "AVX512VL")),
    "skylake-avx512": Processor("skylake-avx512", "SkylakeX", ("ICL", "SPR"), ()),
    "zen": Processor("znver1", "Zen", WIDE, ("AVX512F", "AVX512VL")),
}


def settings(processor: Processor) -> dict[str, str]:
    """Return the environment variables that make this machine compute like a processor."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    has_wide = any(__cpu_features__.get(name) for name in ("AVX512F", "X86_V4"))
    held = processor.openblas == "SkylakeX" and not has_wide
    if held:
        print("  this machine has no AVX-512: compiled code is tuned for it but uses AVX2, BLAS kernels are Haswell's")
    unwanted = [
        name for name in __cpu_dispatch__ if __cpu_features__[name] and any(word in name for word in processor.lacks)
    ]
    return {
        "NUMBA_CPU_NAME": processor.numba,
        "NUMBA_CPU_FEATURES": "-avx512f,-avx512vl,-avx512bw,-avx512dq,-avx512cd" if held else "",
        "OPENBLAS_CORETYPE": "Haswell" if held else processor.openblas,
        "NPY_DISABLE_CPU_FEATURES": " ".join(unwanted),
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=" + ",".join(f"-{name}" for name in processor.hidden)
        if processor.hidden
        else "",
    }


def main() -> int:
    """Run the tests under each processor; return how many of them failed."""
    parser = arguments(__doc__)
    parser.add_argument("--only", choices=PROCESSORS, action="append", help="one processor; repeatable")
    asked, of_pytest = parser.parse_known_args(words(parser, SHORT))
    if platform.machine() not in ("x86_64", "AMD64"):
        print("these are x86-64 processors, and this machine is none")
        return 2
    failed = []
    for name in asked.only or PROCESSORS:
        print(f"{name}:", flush=True)
        chosen = {key: value for key, value in settings(PROCESSORS[name]).items() if value or key.startswith("NUMBA")}
        print("  " + " ".join(f"{key}={value!r}" for key, value in chosen.items()), flush=True)
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *(of_pytest or ["tests"])], cwd=ROOT, env=os.environ | chosen, check=False
        )
        if done.returncode:
            failed.append(name)
    print(f"failed on {', '.join(failed)}" if failed else "passed on each")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
