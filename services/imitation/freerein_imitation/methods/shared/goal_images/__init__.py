"""What `goal_conditioned` and `inverse_model` share: all but the network that chooses actions, and its loss."""
