"""The protocol of a policy, whatever method makes it, and the policies of ppo runs."""
