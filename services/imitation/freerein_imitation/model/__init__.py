"""What every policy is, whatever method makes it, and the policies of ppo runs."""
