"""The game: episodes and the agents that play them, without Gymnasium."""
