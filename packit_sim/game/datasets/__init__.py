"""Packs as files: written, read, verified, and those that other tools wrote."""
