"""What is new since the last time taken up: ``airswing update``.

``months`` says which months are touched, ``model_spans`` which model files each needs,
``corrected_months`` which must be corrected anew; ``taking_up`` tells the whole job.
"""

from airswing.workflow.update.taking_up import update

__all__ = ["update"]
