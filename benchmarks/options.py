"""The command line that all scripts of this folder share: what they do, `--seed`, and a form as short as can be."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence


def arguments(about: str | None, seed: int | None = None, count: int | None = None) -> argparse.ArgumentParser:
    """Return a parser with the script's docstring as help, and with --seed and --count where they have a default."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    if seed is not None:
        parser.add_argument("--seed", type=int, default=seed, help=f"of the first draw [{seed}]")
    if count is not None:
        parser.add_argument("--count", type=int, default=count, help=f"of draws [{count}]")
    return parser


def words(parser: argparse.ArgumentParser, short: Sequence[str] = ()) -> list[str]:
    """Return the words that this process was given; `--short` stands for those of a script's short form."""
    given = sys.argv[1:]
    if short:
        parser.add_argument("--short", action="store_true", help=f"as short as can be: {' '.join(short)}")
    return [*short, *given] if short and "--short" in given else given


def parsed(parser: argparse.ArgumentParser, short: Sequence[str] = ()) -> argparse.Namespace:
    """Return what this process was asked for."""
    return parser.parse_args(words(parser, short))
