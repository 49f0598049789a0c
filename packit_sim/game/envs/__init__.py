"""The game as Gymnasium environments: observations, vector environments, recordings."""
