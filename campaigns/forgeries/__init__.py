"""Forged records of packings: each is verified or refused rightly, and what is resumed is right."""
