"""Numerical methods without grasps: small LPs and QPs, least squares, CasADi functions."""
