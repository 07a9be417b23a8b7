"""Fits of effects to photos, weather files, and the command line."""
