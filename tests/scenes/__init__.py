"""Scenes that tests of several folders, charts and peers share; each is written here once."""
