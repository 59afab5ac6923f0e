"""Importers of public data sets, one module each; see registry for how to add one."""
