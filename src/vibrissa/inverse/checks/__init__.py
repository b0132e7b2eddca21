"""Whether a sweep's own contacts agree with rod, clamp, sensor and clock as stated: what
over-determines them, and which cause explains the remaining misfit.
"""
