"""start"""
import numpy as np
from vibrissa.calibrate.equilibrium import Bench
from vibrissa.calibrate.fit import *
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.reactions import Reactions
from vibrissa.reconstruct import reconstruct
from vibrissa.trail import Trail


def _start(problem, rod, sensor):
    rows = problem.rows
    bench = Bench(rod.bending_stiffness, rod.length, sensor.clamp_position, rotation_matrices(sensor.clamp_orientation), np.ones(6), np.zeros(3), np.eye(3), np.zeros(3))
    c = rows.contact
    axes = rows.pose[c, 3:12].reshape(-1, 3, 3)
    from scipy.spatial.transform import Rotation
    clamp = rows.pose[c, :3] + axes @ bench.clamp
    f = rows.wrench[c, :3]
    m = rows.wrench[c, 3:] - np.cross(bench.clamp - rows.pose[c, 12:], f)
    F = np.einsum("nij,nj->ni", axes, f)
    M = np.einsum("nij,nj->ni", axes, m)
    q = Rotation.from_matrix(axes @ bench.axes).as_quat()
    found = reconstruct(rod, Reactions(Trail(clamp, q), F, M))
    p = found.point
    bad = ~np.isfinite(p).all(1)
    p[bad] = clamp[bad] + rod.length*(axes @ bench.axes)[bad][:,:,2]
    p = problem.surface.nearest(p)
    mag = np.linalg.norm(F, axis=1)
    n = problem.surface.normal(p)
    d = -F/mag[:,None]
    tau = d/np.maximum(np.sum(d*n,axis=1),.3)[:,None]-n if problem.rubs else np.zeros_like(p)
    st = np.concatenate([p, mag[:, None], tau], axis=1)
    return Point(bench, np.zeros((rows.recordings, 12)), st, np.zeros(len(problem.free)))
