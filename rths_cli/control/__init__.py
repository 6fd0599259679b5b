"""Design of the discrete blocks that the step runs: compensators, Kalman filter, numerical substructure; margins."""
