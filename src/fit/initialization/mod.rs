//! The first guess of a fit: amplitudes and albedo in turn, from grey and even light.
pub mod linear;
pub mod place_lobes;

use crate::error::Result;
use crate::fit::components::Unknowns;
use crate::fit::initialization::linear::{solve_albedo, solve_amplitudes};
use crate::fit::initialization::place_lobes::move_lobes_to_the_light;
use crate::light::LightLobe;
use crate::material::{DiffuseAlbedo, MAX_SPECULAR_LOBES, SpecularBlend, SpecularLobe};
use crate::math::shading::{ClosedForm, Layers, Lighting, LobeColumns, PointVisibility, ShadePoint};
use crate::sample::bundle::only_table;
use crate::sample::pixel::Observed;
use crate::sample::point::SurfacePoint;
use crate::shade::ShadingForm;
use crate::shade::systems::{kernel_lobe, kernel_specular};
use crate::visibility::{ObjectVisibility, WindowVisibility};
use bevy_ecs::prelude::World;
use glam::Vec3;
use std::ops::Range;

/// Most pixels the amplitudes are solved from.
const AMPLITUDE_PIXELS: usize = 6144;
/// Most pixels the albedo is solved from…
const ALBEDO_PIXELS: usize = 400_000;
/// …or this many a texel, if that is more.
const PIXELS_PER_TEXEL: usize = 4;
/// Rounds of light, then albedo.
const ROUNDS: usize = 4;
/// Rounds, after the first, that begin by moving faint lobes to where the light is.
const MOVES: usize = 1;

/// Points whose visibility is held at a time.
const CHUNK: usize = 1 << 16;

/// Alternates amplitudes and albedo, whichever are unknown, from grey; `shadowed` by what the world's [`ObjectVisibility`] finds.
pub fn make_first_guess(world: &mut World, unknowns: Unknowns, shadowed: bool) -> Result<()> {
    if !unknowns.light && !unknowns.albedo {
        return Ok(());
    }
    let mut lobes: Vec<LightLobe> = world.query::<&LightLobe>().iter(world).copied().collect();
    let specular = glossiest(world);
    let form = world.resource::<ShadingForm>().0;
    let mut texels: Vec<Vec3> = world.query::<&DiffuseAlbedo>().iter(world).map(|a| a.0).collect();
    let mut visibility = if shadowed { world.remove_resource::<ObjectVisibility>() } else { None };
    let made = {
        let mut query = world.query::<(&SurfacePoint, &ShadePoint, &Observed)>();
        let query = query.query(world);
        let chunks = query.contiguous_iter().map_err(|e| crate::Error::run("fit", e.to_string()));
        let columns = chunks.and_then(|chunks| only_table(chunks, |t| t.0.len(), "pixel"));
        columns.map(|columns| {
            if let Some((points, gathered, observed)) = columns {
                let object = visibility.as_mut();
                let mut guess = Guess { form, points, gathered, observed, specular, unknowns, object };
                guess.alternate(&mut lobes, &mut texels);
            }
        })
    };
    if let Some(visibility) = visibility {
        world.insert_resource(visibility);
    }
    made?;
    for (mut lobe, guess) in world.query::<&mut LightLobe>().iter_mut(world).zip(&lobes) {
        *lobe = *guess;
    }
    for (mut texel, guess) in world.query::<&mut DiffuseAlbedo>().iter_mut(world).zip(&texels) {
        texel.0 = *guess;
    }
    Ok(())
}

/// The glossiest base material that a texel shows: it shows where the light comes from. (With the mean of two, roughness ends farther from the truth.)
fn glossiest(world: &mut World) -> SpecularLobe {
    let mut shown = [false; MAX_SPECULAR_LOBES];
    for blend in world.query::<&SpecularBlend>().iter(world) {
        shown.iter_mut().zip(&blend.0).for_each(|(shown, weight)| *shown |= *weight > 0.0);
    }
    let mut query = world.query::<&SpecularLobe>();
    let lobes = query.iter(world).zip(shown).filter(|(_, shown)| *shown).map(|(lobe, _)| *lobe);
    let first = lobes.min_by(|a, b| a.roughness.total_cmp(&b.roughness));
    first.unwrap_or(SpecularLobe::new(Vec3::ZERO, 1.0))
}

/// The data a first guess is made from.
struct Guess<'a> {
    form: ClosedForm,
    points: &'a [SurfacePoint],
    gathered: &'a [ShadePoint],
    observed: &'a [Observed],
    specular: SpecularLobe,
    unknowns: Unknowns,
    object: Option<&'a mut ObjectVisibility>,
}

impl Guess<'_> {
    fn alternate(&mut self, lobes: &mut [LightLobe], texels: &mut Vec<Vec3>) {
        for round in 0..ROUNDS {
            if self.unknowns.light {
                if (1..=MOVES).contains(&round) {
                    move_lobes_to_the_light(lobes);
                }
                self.solve_light(lobes, texels);
            }
            if self.unknowns.albedo {
                let n = self.points.len().min(ALBEDO_PIXELS.max(PIXELS_PER_TEXEL * texels.len()));
                *texels = self.albedo_under(lobes, texels, n);
            }
        }
    }

    fn solve_light(&mut self, lobes: &mut [LightLobe], texels: &[Vec3]) {
        let n = self.points.len().min(AMPLITUDE_PIXELS);
        let points: Vec<ShadePoint> = (0..n).map(|i| self.with_albedo(i, texels)).collect();
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        self.refresh(&columns, texels);
        let (rows, seen) = self.seen(0..n);
        let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
        let specular = kernel_specular(&self.specular);
        let amplitudes = solve_amplitudes(self.form, &points, &self.observed[..n], &specular, lighting, 1e-2);
        for (lobe, amplitude) in lobes.iter_mut().zip(amplitudes) {
            lobe.amplitude = amplitude.max(Vec3::splat(1e-3));
        }
    }

    fn with_albedo(&self, i: usize, texels: &[Vec3]) -> ShadePoint {
        ShadePoint { albedo: self.points[i].texels.blend(texels).into(), ..self.gathered[i] }
    }

    fn albedo_under(&mut self, lobes: &[LightLobe], texels: &[Vec3], n: usize) -> Vec<Vec3> {
        let columns = LobeColumns::from_lobes(lobes.iter().map(kernel_lobe));
        self.refresh(&columns, texels);
        let specular = kernel_specular(&self.specular);
        let white: Vec<ShadePoint> =
            self.gathered[..n].iter().map(|p| ShadePoint { albedo: [1.0; 3], ..*p }).collect();
        let mut unit = vec![Layers::default(); n];
        for start in (0..n).step_by(CHUNK) {
            let run = start..n.min(start + CHUNK);
            let (rows, seen) = self.seen(run.clone());
            let lighting = Lighting { lobes: &columns, visibility: rows.view(&seen) };
            self.form.shade(&white[run.clone()], &specular, lighting, &mut unit[run]);
        }
        solve_albedo(&self.points[..n], &unit, &self.observed[..n], texels.len(), Vec3::splat(0.4))
    }

    fn refresh(&mut self, lobes: &LobeColumns, texels: &[Vec3]) {
        let gloss = self.specular.albedo;
        if let Some(object) = &mut self.object {
            object.refresh(lobes, &|texel| (texels[texel as usize] + gloss).min(Vec3::ONE));
        }
    }

    /// What a run of the points sees; nothing if visibility is left out.
    fn seen(&self, run: Range<usize>) -> (WindowVisibility, Vec<PointVisibility>) {
        let mut rows = WindowVisibility::default();
        let Some(object) = &self.object else { return (rows, Vec::new()) };
        let mut seen = vec![PointVisibility::OPEN; run.len()];
        let points = (&self.points[run.clone()], &self.gathered[run]);
        object.window(points, |_| self.specular.roughness, &mut rows, &mut seen);
        (rows, seen)
    }
}
