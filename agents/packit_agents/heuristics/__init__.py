"""Rule-based policies for shapes, rotations and locations, and the measures that they use."""
