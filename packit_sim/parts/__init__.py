"""People's own parts, packed into boxes at their real sizes."""
