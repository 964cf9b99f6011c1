//! The search for the normal of one vertex, with its colors in closed form.

use crate::shape::mirror::direction_table::DirectionTable;
use crate::shape::mirror::sights::VertexSight;
use glam::Vec3;
use std::f32::consts::TAU;

/// Least cosine between a normal and the direction to a view that sees the vertex.
const LEAST_COSINE: f32 = 0.05;
/// What speaks against a normal far from the mesh's: part of the squared radiance, for an angle of one radian.
const FAR: f32 = 0.5;
/// Added to the determinant of a vertex's equations, relative to the product of its diagonal.
const DAMPING: f32 = 1e-3;
/// What a vertex that mirrors only dark parts of the light is taken to have seen besides: part of the mean square of the mirrored radiance. Else
/// its mirrored color could be any.
const MIRRORED_FLOOR: f32 = 0.02;

/// The two colors of a vertex, ≥ 0: they multiply the tables.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VertexColors {
    /// Of irradiance.
    pub diffuse: Vec3,
    /// Of mirrored radiance.
    pub mirrored: Vec3,
}

/// Weighted sums over the sights of a vertex, by channel: products of irradiance E, mirrored radiance M and radiance L.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProductSums {
    ee: Vec3,
    mm: Vec3,
    em: Vec3,
    el: Vec3,
    ml: Vec3,
    ll: Vec3,
}

/// The sums of a vertex with this world normal; `None` if one of the views would see it from behind, or there is none.
pub fn moments<'a>(
    sights: impl Iterator<Item = &'a VertexSight>,
    normal: Vec3,
    irradiance: &DirectionTable,
    mirrored: &DirectionTable,
) -> Option<ProductSums> {
    let mut sums = ProductSums::default();
    let mut weight = 0.0;
    for sight in sights {
        let in_light = sight.in_light(normal);
        let cosine = in_light.dot(sight.to_view);
        if cosine < LEAST_COSINE {
            return None;
        }
        let (e, m) = (irradiance.at(in_light), mirrored.at(2.0 * cosine * in_light - sight.to_view));
        let (l, w) = (sight.radiance, sight.weight);
        let (we, wm) = (w * e, w * m);
        sums.ee += we * e;
        sums.mm += wm * m;
        sums.em += we * m;
        sums.el += we * l;
        sums.ml += wm * l;
        sums.ll += w * l * l;
        weight += w;
    }
    sums.mm += MIRRORED_FLOOR * weight * mirrored.mean_square();
    (weight > 0.0).then_some(sums)
}

impl ProductSums {
    /// The colors ≥ 0 with the least squared error.
    pub fn colors(&self) -> VertexColors {
        let (ee, mm) = (self.ee.max(Vec3::splat(1e-20)), self.mm.max(Vec3::splat(1e-20)));
        let determinant = ee * mm * (1.0 + DAMPING) - self.em * self.em;
        let diffuse = (self.el * mm - self.ml * self.em) / determinant;
        let mirrored = (self.ml * ee - self.el * self.em) / determinant;
        let channel = |c: usize| match (diffuse[c] < 0.0, mirrored[c] < 0.0) {
            (false, false) => [diffuse[c], mirrored[c]],
            (true, _) => [0.0, (self.ml[c] / mm[c]).max(0.0)],
            (false, true) => [(self.el[c] / ee[c]).max(0.0), 0.0],
        };
        let [r, g, b] = [0, 1, 2].map(channel);
        VertexColors { diffuse: Vec3::new(r[0], g[0], b[0]), mirrored: Vec3::new(r[1], g[1], b[1]) }
    }

    /// The squared error with these colors.
    pub fn error(&self, colors: &VertexColors) -> f32 {
        let VertexColors { diffuse: a, mirrored: s } = *colors;
        let explained =
            a * (a * self.ee + 2.0 * s * self.em - 2.0 * self.el) + s * (s * self.mm - 2.0 * self.ml);
        (self.ll + explained).element_sum()
    }
}

/// A unit vector and rings of others around it, up to an angle in radians.
pub fn around(axis: Vec3, most: f32, rings: usize) -> impl Iterator<Item = Vec3> {
    let (side, front) = axis.any_orthonormal_pair();
    let ring = move |ring: usize| {
        let (sine, cosine) = (most * ring as f32 / rings as f32).sin_cos();
        let count = 6 * ring;
        (0..count).map(move |i| {
            let (y, x) = (TAU * i as f32 / count as f32).sin_cos();
            (cosine * axis + sine * (x * side + y * front)).normalize()
        })
    };
    std::iter::once(axis).chain((1..=rings).flat_map(ring))
}

/// The candidate with the least error, within an angle (radians) of the normal of the mesh, `given`; `None` if none has sums.
pub(crate) fn best_normal(
    candidates: impl Iterator<Item = Vec3>,
    given: Vec3,
    most: f32,
    moments: impl Fn(Vec3) -> Option<ProductSums>,
) -> Option<Vec3> {
    let mut best: Option<(f32, Vec3)> = None;
    for normal in candidates {
        let angle = normal.angle_between(given);
        let Some(sums) = Some(normal).filter(|_| angle <= most).and_then(&moments) else { continue };
        let error = sums.error(&sums.colors()) + FAR * angle * angle * sums.ll.element_sum();
        if best.is_none_or(|(least, _)| error < least) {
            best = Some((error, normal));
        }
    }
    best.map(|(_, normal)| normal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_are_those_with_the_least_error() {
        let mut sums = ProductSums::default();
        let truth = VertexColors { diffuse: Vec3::new(0.2, 0.0, 0.5), mirrored: Vec3::new(0.1, 0.7, 0.0) };
        for i in 0..40 {
            let (e, m) =
                (Vec3::splat(0.5 + 0.02 * i as f32), Vec3::splat(if i % 9 == 0 { 5.0 } else { 0.1 }));
            let l = truth.diffuse * e + truth.mirrored * m;
            let w = 1.0 / (0.1 + l.element_sum());
            sums.ee += w * e * e;
            sums.mm += w * m * m;
            sums.em += w * e * m;
            sums.el += w * e * l;
            sums.ml += w * m * l;
            sums.ll += w * l * l;
        }
        let found = sums.colors();
        assert!((found.diffuse - truth.diffuse).abs().max_element() < 0.01, "{found:?}");
        assert!((found.mirrored - truth.mirrored).abs().max_element() < 0.01, "{found:?}");
        let least = sums.error(&found);
        for c in 0..3 {
            for change in [-0.05, 0.05] {
                let mut other = found;
                other.diffuse[c] = (other.diffuse[c] + change).max(0.0);
                assert!(sums.error(&other) >= least - 1e-5, "{c} {change}");
            }
        }
    }

    #[test]
    fn rings_reach_the_angle_that_is_asked_for() {
        let axis = Vec3::new(0.3, -0.5, 0.8).normalize();
        let all: Vec<Vec3> = around(axis, 0.4, 5).collect();
        assert_eq!(all.len(), 1 + 6 * 15);
        let widest = all.iter().map(|other| other.angle_between(axis)).fold(0.0, f32::max);
        assert!((widest - 0.4).abs() < 1e-3 && all.iter().all(|n| n.is_normalized()), "{widest}");
    }
}
