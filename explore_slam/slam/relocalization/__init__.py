"""Vehicles that are lost or of unknown start pose: found in the map by landmarks or closures."""
