"""Orchestration of a live run: processes, monitor, run folder."""
