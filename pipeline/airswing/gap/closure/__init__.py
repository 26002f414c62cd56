"""How sure the closure is, and what effects without a claim could still close."""
