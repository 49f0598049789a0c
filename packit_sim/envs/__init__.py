"""The game played on a task, and Gymnasium's face of it."""
