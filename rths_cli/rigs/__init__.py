"""Rigs: what turns a command into motion and motion into samples. Real and virtual ones share `interface.Rig`."""
