"""The waist of the package: a DAE x' = ode, 0 = alg, y = out, and what its rows mean."""
