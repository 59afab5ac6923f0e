"""Data association: which landmark an observation belongs to, in every particle."""
