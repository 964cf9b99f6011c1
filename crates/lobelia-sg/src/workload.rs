//! A reproducible batch of points and lobes to measure and test kernels with.
//!
//! Points have uniform normals and views uniform above them; lobes lie on Fibonacci axes with
//! sharpness 20 + 100·|N(0, 1)|; the specular material is one lobe.

use crate::shading::{
    ClosedForm, Layers, LobeColumns, PointAdjoint, RadianceAdjoint, RadianceColumns, ShadePoint,
    SharedGradient, SpecularValue,
};
use crate::{brdf::Ndf, fibonacci::fibonacci_axes, sg::Lobe};
use glam::Vec3;
use rand::{RngExt, SeedableRng, rngs::SmallRng};

/// A batch to shade, and buffers for its results.
#[derive(Clone, Debug)]
pub struct Workload {
    /// Points to shade.
    pub points: Vec<ShadePoint>,
    /// Light.
    pub lobes: LobeColumns,
    /// Specular material.
    pub specular: SpecularValue,
    /// Output radiance.
    pub shaded: Vec<Layers>,
    /// Adjoint of each point's radiance.
    pub adjoint: Vec<RadianceAdjoint>,
    /// Output adjoints of the points.
    pub point_adjoint: Vec<PointAdjoint>,
    /// Output gradient of the shared parameters.
    pub gradient: SharedGradient,
}

impl Workload {
    /// A batch of `points` × `lobes`, the same every time.
    pub fn new(points: usize, lobes: usize, roughness: f32) -> Self {
        let mut rng = SmallRng::seed_from_u64(2021);
        let lobes = fibonacci_axes(lobes).into_iter().map(|axis| Lobe {
            axis: axis.into(),
            sharpness: 20.0 + 100.0 * normal(&mut rng).abs(),
            amplitude: [1.0, 0.9, 0.8],
        });
        let lobes = LobeColumns::from_lobes(lobes);
        let points: Vec<ShadePoint> = (0..points).map(|_| random_point(&mut rng)).collect();
        Self {
            lobes,
            specular: SpecularValue { albedo: [0.3, 0.2, 0.1], roughness, ndf: Ndf::Sg },
            shaded: vec![Layers::default(); points.len()],
            adjoint: vec![RadianceAdjoint([0.3, 0.5, -0.2]); points.len()],
            point_adjoint: vec![PointAdjoint::default(); points.len()],
            gradient: SharedGradient::default(),
            points,
        }
    }

    /// Runs the forward kernel.
    pub fn shade(&mut self, form: ClosedForm) {
        form.shade(&self.points, &self.specular, &self.lobes, &mut self.shaded);
    }

    /// Runs the adjoint kernel.
    pub fn shade_adjoint(&mut self, form: ClosedForm) {
        let radiance = RadianceColumns { shaded: &self.shaded, adjoint: &self.adjoint };
        let (out, gradient) = (&mut self.point_adjoint, &mut self.gradient);
        form.shade_adjoint(&self.points, &self.specular, &self.lobes, radiance, out, gradient);
    }
}

/// A standard normal number (Box and Muller).
fn normal(rng: &mut SmallRng) -> f32 {
    let (radius, turn) = (1.0 - rng.random::<f32>(), rng.random::<f32>());
    (-2.0 * radius.ln()).sqrt() * (std::f32::consts::TAU * turn).cos()
}

fn random_point(rng: &mut SmallRng) -> ShadePoint {
    let mut direction =
        || Vec3::new(normal(rng), normal(rng), normal(rng)).try_normalize().unwrap_or(Vec3::Y);
    let (n, v) = (direction(), direction());
    let to_viewer = if n.dot(v) < 0.0 { -v } else { v };
    ShadePoint { normal: n.into(), to_viewer: to_viewer.into(), albedo: [0.5, 0.4, 0.3] }
}
