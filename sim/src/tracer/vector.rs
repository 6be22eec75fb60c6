//! Three-vectors of f64: the few operations that rays need.

/// A point or direction.
pub(super) type Vector = [f64; 3];

/// a + s·b
#[inline(always)]
pub(super) fn along(a: Vector, s: f64, b: Vector) -> Vector {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

/// a − b
#[inline(always)]
pub(super) fn sub(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Scalar product.
#[inline(always)]
pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
#[inline(always)]
pub(super) fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Unit vector, or none where the length is zero or undefined; safe from overflow.
pub(super) fn unit(a: Vector) -> Option<Vector> {
    let largest = a[0].abs().max(a[1].abs()).max(a[2].abs());
    if !(a.iter().all(|c| c.is_finite()) && largest > 0.0) {
        return None;
    }
    let b = a.map(|c| c / largest);
    let length = dot(b, b).sqrt();
    Some(b.map(|c| c / length))
}

/// Two unit vectors that complete the unit vector `w` to a right-handed frame, without a singular direction:
/// T. Duff et al., J. Comput. Graph. Techniques 6(1), 1 (2017).
#[inline(always)]
pub(super) fn frame(w: Vector) -> (Vector, Vector) {
    let sign = if w[2] < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + w[2]);
    let b = w[0] * w[1] * a;
    ([1.0 + sign * w[0] * w[0] * a, sign * b, -sign * w[0]], [b, sign + w[1] * w[1] * a, -w[1]])
}

/// The unit vector at angle acos(`cosine`) from the unit vector `axis`, azimuth `phi_rad`.
#[inline(always)]
pub(super) fn turn(axis: Vector, cosine: f64, sine: f64, phi_rad: f64) -> Vector {
    let (u, v) = frame(axis);
    let (s, c) = phi_rad.sin_cos();
    let d = [
        sine * (c * u[0] + s * v[0]) + cosine * axis[0],
        sine * (c * u[1] + s * v[1]) + cosine * axis[1],
        sine * (c * u[2] + s * v[2]) + cosine * axis[2],
    ];
    // One Newton step keeps the length at 1 over thousands of turns.
    let correction = 1.5 - 0.5 * dot(d, d);
    d.map(|x| x * correction)
}
