"""`rths run` without what takes longest before it moves: the record that verifies the model, and most of the rehearsal.

python fault_runner.py run CASE... as `rths run CASE...`; RTHS_FAULTS_REHEARSAL_S: how long the rehearsal takes.
"""

from __future__ import annotations

import os

from rths_cli.experiment import model_verification, real_rig_readiness

model_verification.verify = lambda setup, known, progress: ((), "not verified: faults are injected")
real_rig_readiness.LISTENING_S = 0.3
if "RTHS_FAULTS_REHEARSAL_S" in os.environ:
    real_rig_readiness.REHEARSAL_S = float(os.environ["RTHS_FAULTS_REHEARSAL_S"])
else:
    real_rig_readiness.rehearsed = lambda setup, blocks, source: None

if __name__ == "__main__":
    from rths_cli.cli import main

    main()
