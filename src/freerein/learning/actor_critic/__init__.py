"""Actor-critic networks: what ppo runs train, and what the imitation service serves of them."""
