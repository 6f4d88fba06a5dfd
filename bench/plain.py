"""The same work in plain loops, compiled by numba: what a capable programmer writes in an afternoon.

Cubic B-splines with the boundary rule "mirror", float32. Arrays are [z, y, x], coefficients have no halo, points are (x, y, z)
in samples.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

POLE = np.float32(math.sqrt(3.0) - 2.0)
GAIN = np.float32(6.0)
REACH = 14  # samples in the initial sum of the recursion: POLE**14 is 1e-8
SIXTH, THIRD = np.float32(1 / 6), np.float32(1 / 3)


# -- prefilter -------------------------------------------------------------------------------------------


@njit(parallel=True, fastmath=True, cache=False)
def prefilter(data):
    """Coefficients of samples at least `REACH` long along each axis."""
    nz, ny, nx = data.shape
    c = np.empty_like(data)
    for z in prange(nz):
        for y in range(ny):  # along x: one line after the other
            line = c[z, y]
            for x in range(nx):
                line[x] = GAIN * data[z, y, x]
            start = line[0]
            power = POLE
            for i in range(1, REACH):
                start += power * line[i]
                power *= POLE
            line[0] = start
            for x in range(1, nx):
                line[x] += POLE * line[x - 1]
            line[nx - 1] = POLE / (POLE * POLE - 1) * (line[nx - 1] + POLE * line[nx - 2])
            for x in range(nx - 2, -1, -1):
                line[x] = POLE * (line[x + 1] - line[x])
        _prefilter_rows(c[z])  # along y
    for y in prange(ny):
        _prefilter_rows(c[:, y])  # along z
    return c


@njit(fastmath=True)
def _prefilter_rows(c):
    """Along the first of two axes: a whole row at once."""
    n, width = c.shape
    for i in range(n):
        for x in range(width):
            c[i, x] *= GAIN
    power = POLE
    for i in range(1, REACH):
        for x in range(width):
            c[0, x] += power * c[i, x]
        power *= POLE
    for i in range(1, n):
        for x in range(width):
            c[i, x] += POLE * c[i - 1, x]
    for x in range(width):
        c[n - 1, x] = POLE / (POLE * POLE - 1) * (c[n - 1, x] + POLE * c[n - 2, x])
    for i in range(n - 2, -1, -1):
        for x in range(width):
            c[i, x] = POLE * (c[i + 1, x] - c[i, x])


# -- sampling ----------------------------------------------------------------------------------------------


@njit(inline="always", fastmath=True)
def _weights(t):
    s = np.float32(1) - t
    a, d = SIXTH * s * s * s, SIXTH * t * t * t
    b = np.float32(2) * THIRD + t * t * (np.float32(0.5) * t - np.float32(1))
    return a, b, np.float32(1) - a - b - d, d


@njit(inline="always", fastmath=True)
def _slopes(t):
    s = np.float32(1) - t
    a, d = np.float32(-0.5) * s * s, np.float32(0.5) * t * t
    b = t * (np.float32(1.5) * t - np.float32(2))
    return a, b, -a - b - d, d


@njit(inline="always", fastmath=True)
def _fold(i, n):
    i = abs(i)
    return 2 * (n - 1) - i if i >= n else i


@njit(inline="always", fastmath=True)
def _value(c, x, y, z):
    nz, ny, nx = c.shape
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    wx, wy, wz = _weights(x - np.float32(i)), _weights(y - np.float32(j)), _weights(z - np.float32(k))
    sum_z = np.float32(0)
    if 0 < i < nx - 2 and 0 < j < ny - 2 and 0 < k < nz - 2:
        for r in range(4):
            sum_y = np.float32(0)
            for q in range(4):
                row = c[k - 1 + r, j - 1 + q]
                sum_y += wy[q] * (wx[0] * row[i - 1] + wx[1] * row[i] + wx[2] * row[i + 1] + wx[3] * row[i + 2])
            sum_z += wz[r] * sum_y
    else:
        for r in range(4):
            for q in range(4):
                for p in range(4):
                    sum_z += wz[r] * wy[q] * wx[p] * c[_fold(k - 1 + r, nz), _fold(j - 1 + q, ny), _fold(i - 1 + p, nx)]
    return sum_z


@njit(inline="always", fastmath=True)
def _gradient(c, x, y, z):
    nz, ny, nx = c.shape
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    wx, wy, wz = _weights(x - np.float32(i)), _weights(y - np.float32(j)), _weights(z - np.float32(k))
    sx, sy, sz = _slopes(x - np.float32(i)), _slopes(y - np.float32(j)), _slopes(z - np.float32(k))
    gx, gy, gz = np.float32(0), np.float32(0), np.float32(0)
    for r in range(4):
        value_y, slope_x, slope_y = np.float32(0), np.float32(0), np.float32(0)
        for q in range(4):
            value, slope = np.float32(0), np.float32(0)
            row = c[_fold(k - 1 + r, nz), _fold(j - 1 + q, ny)]
            for p in range(4):
                at = row[_fold(i - 1 + p, nx)]
                value += wx[p] * at
                slope += sx[p] * at
            value_y += wy[q] * value
            slope_y += sy[q] * value
            slope_x += wy[q] * slope
        gx += wz[r] * slope_x
        gy += wz[r] * slope_y
        gz += sz[r] * value_y
    return gx, gy, gz


@njit(parallel=True, fastmath=True)
def sample(c, points):
    result = np.empty(points.shape[0], np.float32)
    for i in prange(points.shape[0]):
        result[i] = _value(c, points[i, 0], points[i, 1], points[i, 2])
    return result


@njit(parallel=True, fastmath=True)
def sample_gradient(c, points):
    result = np.empty((points.shape[0], 3), np.float32)
    for i in prange(points.shape[0]):
        result[i, 0], result[i, 1], result[i, 2] = _gradient(c, points[i, 0], points[i, 1], points[i, 2])
    return result


@njit(parallel=True, fastmath=True)
def sample_linear(data, points):
    nz, ny, nx = data.shape
    result = np.empty(points.shape[0], np.float32)
    for n in prange(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i, j, k = min(max(int(x), 0), nx - 2), min(max(int(y), 0), ny - 2), min(max(int(z), 0), nz - 2)
        t, u, v = x - np.float32(i), y - np.float32(j), z - np.float32(k)
        a, b, d, e = data[k, j], data[k, j + 1], data[k + 1, j], data[k + 1, j + 1]
        low = a[i] + t * (a[i + 1] - a[i])
        high = b[i] + t * (b[i + 1] - b[i])
        near = low + u * (high - low)
        low = d[i] + t * (d[i + 1] - d[i])
        high = e[i] + t * (e[i + 1] - e[i])
        result[n] = near + v * (low + u * (high - low) - near)
    return result


# -- twice the samples -----------------------------------------------------------------------------------


@njit(parallel=True, fastmath=True)
def magnify(data):
    """Twice the samples along each axis, axis by axis; sample j lies at j / 2 of the input."""
    c = prefilter(data)
    nz, ny, nx = c.shape
    result = np.empty((2 * nz, 2 * ny, 2 * nx), np.float32)
    for k in prange(nz):
        plane = np.empty((ny, nx), np.float32)
        rows = np.empty((2, nx), np.float32)
        for odd in range(2):
            before, after, past = c[_fold(k - 1, nz)], c[_fold(k + 1, nz)], c[_fold(k + 2, nz)]
            for y in range(ny):
                for x in range(nx):
                    plane[y, x] = _half(before[y, x], c[k, y, x], after[y, x], past[y, x], odd)
            for j in range(ny):
                before, after, past = plane[_fold(j - 1, ny)], plane[_fold(j + 1, ny)], plane[_fold(j + 2, ny)]
                for x in range(nx):
                    rows[0, x] = _half(before[x], plane[j, x], after[x], past[x], 0)
                    rows[1, x] = _half(before[x], plane[j, x], after[x], past[x], 1)
                for half in range(2):
                    target = result[2 * k + odd, 2 * j + half]
                    row = rows[half]
                    for i in range(1, nx - 2):
                        target[2 * i] = _half(row[i - 1], row[i], row[i + 1], row[i + 2], 0)
                        target[2 * i + 1] = _half(row[i - 1], row[i], row[i + 1], row[i + 2], 1)
                    for i in (0, nx - 2, nx - 1):
                        a, d, e = row[_fold(i - 1, nx)], row[_fold(i + 1, nx)], row[_fold(i + 2, nx)]
                        target[2 * i] = _half(a, row[i], d, e, 0)
                        target[2 * i + 1] = _half(a, row[i], d, e, 1)
    return result


@njit(inline="always", fastmath=True)
def _half(before, here, after, past, odd):
    """The spline at a sample, or half-way to the next."""
    if odd:
        return (before + past + np.float32(23) * (here + after)) * np.float32(1 / 48)
    return (before + after + np.float32(4) * here) * SIXTH


# -- a surface -----------------------------------------------------------------------------------------------


@njit(parallel=True, fastmath=True)
def isosurface(c, eye, corner, across, down, width, height, isovalue, step, color):
    """The first surface of a value along each ray, shaded by a headlight; rays step `step` voxels, then bisect.

    Rays leave `eye` towards ``corner + i * across + j * down``, all in samples.
    """
    picture = np.zeros((height, width, 4), np.float32)
    picture[:, :, 3] = 1
    size = (c.shape[2], c.shape[1], c.shape[0])
    for j in prange(height):
        direction = np.empty(3, np.float32)
        for i in range(width):
            enter, leave, squared = np.float32(0), np.float32(1e9), np.float32(0)
            for a in range(3):
                direction[a] = corner[a] + (i + 0.5) * across[a] + (j + 0.5) * down[a]
                squared += direction[a] * direction[a]
            for a in range(3):
                direction[a] /= np.sqrt(squared)
                near, far = (np.float32(-0.5) - eye[a]) / direction[a], (np.float32(size[a] - 0.5) - eye[a]) / direction[a]
                enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
            dx, dy, dz = direction
            before = np.float32(0)
            first = True
            t = enter + np.float32(0.5) * step
            while t < leave:
                value = _value(c, eye[0] + t * dx, eye[1] + t * dy, eye[2] + t * dz) - isovalue
                if not first and (value < 0) != (before < 0):
                    low, high = t - step, t
                    for _ in range(10):
                        middle = np.float32(0.5) * (low + high)
                        value = _value(c, eye[0] + middle * dx, eye[1] + middle * dy, eye[2] + middle * dz) - isovalue
                        if (value < 0) == (before < 0):
                            low = middle
                        else:
                            high = middle
                    gx, gy, gz = _gradient(c, eye[0] + high * dx, eye[1] + high * dy, eye[2] + high * dz)
                    cosine = abs(gx * dx + gy * dy + gz * dz) / np.sqrt(gx * gx + gy * gy + gz * gz)
                    for a in range(3):
                        shine = np.float32(0.25) * color[a] + np.float32(0.75) * cosine * color[a] + np.float32(0.2) * cosine**30
                        picture[j, i, a] = min(np.float32(1), shine)
                    break
                before = value
                first = False
                t += step
    return picture
