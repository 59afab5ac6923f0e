"""Emulated hardware: the device side of the serial protocols."""
