"""A user's first session: data is recorded, models are fitted to it, and all is measured, as one pipeline."""

from experiments.first_session.experiment import FirstSession

EXPERIMENT = FirstSession()
