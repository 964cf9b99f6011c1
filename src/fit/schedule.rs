//! What changes from step to step: rates fall at the milestones, and before the first one a step visits fewer pixels. While rates are high the noise of few pixels
//! does no harm; later it would stay in the albedo.

use super::components::StepRates;
use super::groups::StepPixels;
use super::run::FitOptions;

/// Part of the pixels of a step that a `Fit` visits before the first milestone.
pub(crate) const EARLY: f32 = 0.5;

/// How many pixels the steps visit: fewer before the first milestone.
pub(super) fn step_pixels(options: &FitOptions) -> StepPixels {
    let early = (options.early * options.batch as f32).ceil() as usize;
    let steps = (1..=options.steps).take_while(|step| milestones_before(*step, options) == 0).count();
    StepPixels { early: (early, steps as u32), late: options.batch }
}

/// Milestones that a step has behind it.
fn milestones_before(step: u32, options: &FitOptions) -> usize {
    let done = (step - 1) as f32 / options.steps as f32;
    options.milestones.iter().filter(|milestone| **milestone <= done).count()
}

/// The rates of a step, from 1, which is a visit to its group.
pub(super) fn rates_at(step: u32, visit: u32, options: &FitOptions) -> StepRates {
    let done = (step - 1) as f32 / options.steps as f32;
    let factor = options.decay.powi(milestones_before(step, options) as i32);
    let [albedo, light, specular] = options.rates.map(|rate| rate * factor);
    StepRates { step, visit, progress: done, albedo, light, specular }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_fall_and_pixels_rise_at_the_first_milestone() {
        let options = FitOptions {
            steps: 10,
            batch: 100,
            early: 0.5,
            milestones: vec![0.3, 0.8],
            decay: 0.5,
            rates: [1.0, 2.0, 4.0],
            ..FitOptions::default()
        };
        let pixels = step_pixels(&options);
        assert_eq!(pixels, StepPixels { early: (50, 3), late: 100 });
        let lights: Vec<f32> = (1..=10).map(|step| rates_at(step, step, &options).light).collect();
        assert_eq!(lights, [2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.5]);
        let all = step_pixels(&FitOptions { milestones: Vec::new(), ..options });
        assert_eq!(all, StepPixels { early: (50, 10), late: 100 });
    }
}
