"""Episodes of the game and the agents that play them, without Gymnasium."""
