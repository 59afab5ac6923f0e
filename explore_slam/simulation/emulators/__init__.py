"""Emulated vehicle hardware: the device side of the serial protocols, with faults."""
