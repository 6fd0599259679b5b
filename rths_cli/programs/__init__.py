"""A program as the numerical substructure: displacements of its floors in, restoring forces out, in its own process.

A program knows nothing of masses that move, of damping or of time: it is an equilibrium at prescribed displacements.
Displacements and forces (p,) are in m and N, from the lowest floor with mass to the interface, the last.
"""

from rths_cli.programs.process import Described, Description, Program, ProgramFault, described, step_times

__all__ = ["Described", "Description", "Program", "ProgramFault", "described", "step_times"]
