//! What changes from step to step: rates fall at the milestones, and before the first one a step visits fewer pixels. While rates are high the noise of few pixels
//! does no harm; later it would stay in the albedo.

use super::components::StepRates;
use super::groups::StepPixels;

/// Part of the pixels of a step that a `Fit` visits before the first milestone.
pub(crate) const EARLY: f32 = 0.5;

/// How the steps of a fit differ; fields as in [`FitOptions`](super::run::FitOptions).
#[derive(Clone, Copy)]
pub(super) struct Schedule<'a> {
    pub steps: u32,
    pub batch: usize,
    pub early: f32,
    pub milestones: &'a [f32],
    pub decay: f32,
    pub rates: [f32; 3],
}

impl Schedule<'_> {
    /// How many pixels the steps visit: fewer before the first milestone.
    pub fn pixels(&self) -> StepPixels {
        let early = (self.early * self.batch as f32).ceil() as usize;
        // Bisected: a fit that is to be stopped by hand may have any number of steps.
        let (mut steps, mut end) = (0, self.steps);
        while steps < end {
            let middle = steps + (end - steps) / 2;
            match self.milestones_before(middle + 1) {
                0 => steps = middle + 1,
                _ => end = middle,
            }
        }
        StepPixels { early: (early, steps), late: self.batch }
    }

    /// Milestones that a step has behind it.
    fn milestones_before(&self, step: u32) -> usize {
        let done = (step - 1) as f32 / self.steps as f32;
        self.milestones.iter().filter(|milestone| **milestone <= done).count()
    }

    /// The rates of a step, from 1, which is a visit to its group.
    pub fn rates_at(&self, step: u32, visit: u32) -> StepRates {
        let done = (step - 1) as f32 / self.steps as f32;
        let factor = self.decay.powi(self.milestones_before(step) as i32);
        let [albedo, light, specular] = self.rates.map(|rate| rate * factor);
        StepRates { step, visit, progress: done, albedo, light, specular }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_fall_and_pixels_rise_at_the_first_milestone() {
        let schedule = Schedule {
            steps: 10,
            batch: 100,
            early: 0.5,
            milestones: &[0.3, 0.8],
            decay: 0.5,
            rates: [1.0, 2.0, 4.0],
        };
        assert_eq!(schedule.pixels(), StepPixels { early: (50, 3), late: 100 });
        let lights: Vec<f32> = (1..=10).map(|step| schedule.rates_at(step, step).light).collect();
        assert_eq!(lights, [2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.5]);
        let all = Schedule { milestones: &[], ..schedule };
        assert_eq!(all.pixels(), StepPixels { early: (50, 10), late: 100 });
    }
}
