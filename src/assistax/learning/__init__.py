"""Learning: one PPO and one SAC for teams, and the separately tested parts it is made of."""
