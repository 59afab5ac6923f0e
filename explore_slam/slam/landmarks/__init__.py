"""The landmark map."""
