"""Success criteria on the true states of `blocks`. For evaluation only: no learner sees a true state."""
