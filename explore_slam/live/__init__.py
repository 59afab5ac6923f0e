"""Orchestration of a live run: the processes of its nodes, the monitor, the run folder."""
