//! The scene file that the command line names.

use super::run_args::SceneArgs;
use lobelia::scene::LoadOptions;

/// What the command line adds to a scene file, as the library reads it.
pub fn load_options(args: &SceneArgs) -> LoadOptions {
    LoadOptions {
        data: args.data.clone(),
        sets: args.sets.clone(),
        seed: args.seed,
        without_data: false,
        confined: !args.allow_outside,
    }
}
