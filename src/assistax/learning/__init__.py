"""Learning: one PPO for teams, and the separately tested parts it is made of."""
