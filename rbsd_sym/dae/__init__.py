"""The waist: x' = ode, 0 = alg, y = out, with what their rows mean."""
