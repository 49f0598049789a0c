"""What the placement engine's answers cost, beside other ways to get them."""
