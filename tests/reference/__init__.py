"""Irradiance known without photonrelax: closed forms, quadrature and direct deposits."""
