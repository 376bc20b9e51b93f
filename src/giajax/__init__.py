"""A differentiable simulator of very long, very light, air-dominated robot arms."""
