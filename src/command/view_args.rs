//! What can be typed after `lobelia view`.

use super::threads::ThreadArgs;
use clap::Args;
use std::path::PathBuf;

/// The long help.
pub const VIEW_LONG: &str = "\
Writes OUT/view.html: one page that shows the object that a run saved, and needs nothing else, no server and no network.

The object is turned with mouse, touch or keyboard, under the light that was found or under lights given with
--light; roughness, reflection, color and exposure have sliders; what was done can be copied as a pass for a scene
file. The photographs, if they are still there, are laid beside the picture under a wipe. A pass View() in a scene
file writes the same page, with the lights of the scene's own passes.";

/// `lobelia view`.
#[derive(Args, Debug)]
pub struct ViewArgs {
    /// The output folder of a run with a `Save` pass, or a scene file in which all is known
    #[arg(value_name = "OUT")]
    pub out: PathBuf,
    /// Offer this light too: .ron, .npy lobes, or an OpenEXR or Radiance HDR map
    #[arg(long = "light", value_name = "FILE")]
    pub lights: Vec<PathBuf>,
    /// Most photographs in the page, beside which it shows its own picture; 0: none
    #[arg(long, value_name = "N", default_value_t = 24)]
    pub photographs: u32,
    /// The folder that $DATA stands for in the scene file, and that its photographs may be in
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Read also what the scene file names outside its own folder and --data
    #[arg(long)]
    pub allow_outside: bool,
    /// How many threads.
    #[command(flatten)]
    pub threads: ThreadArgs,
}
