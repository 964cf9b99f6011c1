//! The choice of pixels for a fit.

use super::candidate::{Candidate, Candidates, GradientsNeeded, PixelChoice};
use super::views::{ObservedView, SharedViews, ViewColumns, training_views, usable_counts};
use crate::error::{Error, Result};
use crate::light::placement::{LightGroup, Placements};
use crate::material::TexelIndex;
use crate::pipeline::SystemResult;
use crate::ranks::Ranks;
use crate::view::{ByView, Placement, ViewIndex};
use bevy_ecs::prelude::{Query, Res, ResMut, With};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng, rngs::SmallRng};
use rayon::prelude::*;

/// Pixels a texel from which chance gives each enough: shares then make the light slightly worse (`docs/src/ablation.md`).
const ENOUGH_PER_TEXEL: usize = 4;
/// Pixels that are drawn and traced for each that is chosen, where texels get their shares.
const DRAWN: usize = 2;
/// Most usable pixels whose order is shuffled; of more, the chosen ones are drawn one by one.
const MOST_SHUFFLED: usize = 1 << 26;

/// Sample: chooses the usable foreground pixels of the training views, in an order shuffled by the seed.
pub fn choose_pixels(
    choice: Res<PixelChoice>,
    views: Query<ViewColumns>,
    (placed, placements): (Query<(&ViewIndex, &Placement)>, Option<Res<Placements>>),
    texels: Query<(), With<TexelIndex>>,
    (ranks, gradients): (Option<Res<Ranks>>, Option<Res<GradientsNeeded>>),
    mut candidates: ResMut<Candidates>,
) -> SystemResult {
    let training = training_views(views.iter(), ranks.as_deref());
    let gradients = gradients.is_some();
    let few = choice.max_pixels / ENOUGH_PER_TEXEL < texels.iter().len();
    let drawn = if choice.evenly && few { DRAWN } else { 1 };
    let choice = PixelChoice { max_pixels: choice.max_pixels.saturating_mul(drawn), ..*choice };
    candidates.0 = match Windows::new(&training, gradients).scattered(choice)? {
        Some(scattered) => scattered,
        None => any_of_all(&training, choice, gradients)?,
    };
    // Steps visit groups of photographs one at a time.
    if let Some(placements) = placements.filter(|placements| placements.has_groups()) {
        let of_view = |(view, placement): (&ViewIndex, &Placement)| (*view, placements.light(*placement));
        let groups: ByView<LightGroup> = placed.iter().map(of_view).collect();
        candidates.0.sort_by_key(|candidate| groups.get(candidate.pixel.view).copied());
    }
    Ok(())
}

/// Usable pixels in a random order, cut short; every pixel of every view is looked at.
fn any_of_all(training: &SharedViews, choice: PixelChoice, gradients: bool) -> Result<Vec<Candidate>> {
    let counts = usable_counts(training)?;
    let total: usize = counts.iter().sum();
    if total == 0 {
        let views = training.items.len();
        return Err(Error::run(
            "fit",
            format!("no usable foreground pixel in {views} training views (masked out, or all saturated)"),
        ));
    }
    candidates_of(training, &counts, &shuffled(total, choice), gradients)
}

/// From so many times the pixels that may be chosen on, a part of them is looked at.
const SPARSE: usize = 16;
/// Strata that are tried first, to learn which part of the pixels is usable; and how many of them must be.
const TRIED: usize = 1 << 16;
const LEAST_USABLE: usize = 256;

/// The pixels of the windows of all views, numbered through.
pub(super) struct Windows<'a> {
    training: &'a SharedViews<'a>,
    /// The number of each view's first pixel.
    first: Vec<usize>,
    total: usize,
    gradients: bool,
}

impl<'a> Windows<'a> {
    pub fn new(training: &'a SharedViews<'a>, gradients: bool) -> Self {
        let mut total = 0;
        let mut first = Vec::with_capacity(training.items.len());
        for view in &training.items {
            first.push(total);
            total += view.window().len();
        }
        Self { training, first, total, gradients }
    }

    /// About as many usable pixels as may be chosen, in a random order: one at random of each of as many equal strata as are needed, so that each
    /// view, and each part of it, has its share. `None` if they are so few that all should be looked at.
    ///
    /// Takes time by the number of chosen pixels, not of photographs.
    pub fn scattered(&self, choice: PixelChoice) -> Result<Option<Vec<Candidate>>> {
        if self.total / SPARSE < choice.max_pixels.max(TRIED) {
            return Ok(None);
        }
        let mut random = SmallRng::seed_from_u64(choice.seed);
        let usable = self.draw(TRIED, random.random())?.len();
        let strata = choice.max_pixels * TRIED / usable.max(1);
        if usable < LEAST_USABLE || strata > self.total / 2 {
            return Ok(None);
        }
        let mut chosen = self.draw(strata, random.random())?;
        chosen.shuffle(&mut random);
        chosen.truncate(choice.max_pixels);
        Ok(Some(chosen))
    }

    /// The usable ones of one random pixel in each stratum, in the order of the strata.
    fn draw(&self, strata: usize, seed: u64) -> Result<Vec<Candidate>> {
        let edge = |stratum: usize| (stratum as u128 * self.total as u128 / strata as u128) as usize;
        let near = |number: usize| (number as u128 * strata as u128 / self.total as u128) as usize;
        let of_view = |at: usize, view: &ObservedView| -> Vec<Candidate> {
            let window = view.window();
            let numbers = self.first[at]..self.first[at] + window.len();
            // A stratum may begin or end in another view, where the pixel then mostly is.
            let some = near(numbers.start).saturating_sub(1)..(near(numbers.end) + 2).min(strata);
            let pixel_of = |stratum: usize| {
                let mut random = SmallRng::seed_from_u64(seed.wrapping_add(stratum as u64));
                let number = random.random_range(edge(stratum)..edge(stratum + 1));
                let place = numbers.contains(&number).then(|| number - numbers.start)?;
                Some(window.pixel(place, view.camera.width)).filter(|pixel| view.is_usable(*pixel))
            };
            some.filter_map(pixel_of).map(|pixel| view.candidate(pixel, self.gradients)).collect()
        };
        Ok(self.training.each(of_view)?.into_iter().flatten().collect())
    }
}

/// Numbers from 0 to `total` in a random order, cut short.
fn shuffled(total: usize, choice: PixelChoice) -> Vec<u32> {
    let mut random = SmallRng::seed_from_u64(choice.seed);
    if total > MOST_SHUFFLED {
        let drawn = rand::seq::index::sample(&mut random, total, choice.max_pixels.min(total));
        return drawn.into_iter().map(|i| i as u32).collect();
    }
    let mut order: Vec<u32> = (0..total as u32).collect();
    order.shuffle(&mut random);
    order.truncate(choice.max_pixels);
    order.shrink_to_fit();
    order
}

/// The pixels with these numbers, counted over the usable pixels of all views.
fn candidates_of(
    training: &SharedViews,
    counts: &[usize],
    chosen: &[u32],
    gradients: bool,
) -> Result<Vec<Candidate>> {
    let mut by_number: Vec<(u32, u32)> =
        chosen.iter().zip(0..).map(|(number, place)| (*number, place)).collect();
    by_number.par_sort_unstable();
    let mut rest = by_number.as_slice();
    let mut first = 0;
    let mut parts = Vec::new();
    for count in counts {
        let (of_view, others) =
            rest.split_at(rest.partition_point(|(number, _)| (*number as usize) < first + count));
        parts.push((first, of_view));
        (rest, first) = (others, first + count);
    }
    let found = training.each(|at, view| view.candidates(parts[at].0, parts[at].1, gradients))?;
    let mut candidates = vec![Candidate::default(); chosen.len()];
    for ((_, place), candidate) in by_number.iter().zip(found.into_iter().flatten()) {
        candidates[*place as usize] = candidate;
    }
    Ok(candidates)
}
