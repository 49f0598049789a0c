"""What happens to a packing outside the search: removal, supports, stability, constraints."""
