//! Reading of the photographs of a data set. Several processes each read a share: the pixels of training photographs stay where they are read, and those of
//! test views, which nobody fits to, go to the first process. All else that is known of a view, its mask too, goes to all.

use crate::checkpoint::packed::{from_bytes, to_bytes};
use crate::dataset::{LoadedView, PlannedView, load_notes};
use crate::error::stop::check_interrupted;
use crate::error::{Error, Result};
use crate::pass::progress::Progress;
use crate::ranks::owned::AT_A_TIME;
use crate::ranks::{Ranks, share};
use crate::scene::{Pass, Scene, Surface};
use crate::survey::open::OpenScene;
use crate::survey::{Severity, Survey, ViewLook};
use crate::view::{Photograph, Split, ViewRecord};
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::Range;

/// A view, and what a survey keeps of it.
type ReadView = (LoadedView, Option<ViewLook>);

/// Reads the views of a data set that is open, and surveys those that passes learn from or are scored against: a warning is a note, the first
/// error ends the run.
///
/// # Errors
/// [`Error::Usage`](crate::Error::Usage) for the first thing that cannot work; those of reading photographs and masks; if another process is gone.
pub(super) fn read_data(
    scene: &Scene,
    open: &OpenScene,
    ranks: Option<&Ranks>,
    progress: &dyn Progress,
) -> Result<(Vec<ViewRecord>, Option<Survey>)> {
    let learns = |pass: &Pass| matches!(pass, Pass::Fit(_) | Pass::Shape(_) | Pass::Evaluate(_));
    let is_used = matches!(scene.surface, Surface::Unknown { .. }) || scene.passes.iter().any(learns);
    let bar = progress.bar("photographs", open.views.len() as u64);
    let read = |view: &PlannedView| {
        check_interrupted()?;
        let loaded = open.load(view)?;
        let look = is_used.then(|| open.look(view, &loaded, false));
        bar.inc(1);
        Ok((loaded, look))
    };
    let read = match ranks {
        None => read_all(&open.views, read)?,
        Some(ranks) => {
            let views = read_shares(&open.views, ranks, read, || bar.inc(1))?;
            let sent = ranks.take_traffic().of_shares;
            let (count, mb) = (ranks.size(), sent.bytes as f64 / 1e6);
            progress.print(&format!(
                "photographs: read by {count} processes, each of which keeps those that it has read, and received {mb:.1} MB, in {:.1} s with waiting",
                sent.seconds
            ));
            views
        }
    };
    let (loaded, looks): (Vec<LoadedView>, Vec<Option<ViewLook>>) = read.into_iter().unzip();
    bar.finish_and_clear();
    open.notes.iter().chain(&load_notes(&loaded)).for_each(|note| progress.note(note));
    let looks = looks.into_iter().flatten().collect();
    let survey = is_used.then(|| surveyed(open, looks, progress)).transpose()?;
    Ok((loaded.into_iter().map(|view| view.record).collect(), survey))
}

/// The survey of what was looked at; its warnings are told, its first error is one.
fn surveyed(open: &OpenScene, looks: Vec<ViewLook>, progress: &dyn Progress) -> Result<Survey> {
    let survey = open.examine(looks)?;
    survey.findings_of(Severity::Warning).for_each(|warning| progress.note(&warning.problem));
    let error = survey.findings_of(Severity::Error).next().map(|error| error.to_error());
    error.map_or(Ok(survey), Err)
}

/// Reads views on all threads; the first error, in their order, ends it.
fn read_all<T: Send>(
    views: &[PlannedView],
    read: impl Fn(&PlannedView) -> Result<T> + Sync + Send,
) -> Result<Vec<T>> {
    let read: Vec<Result<T>> = views.par_iter().map(read).collect();
    read.into_iter().collect()
}

/// Reads a share of the views and gets the others from those that read them, most without their pixels; `arrived` is told of each of these. A view is the
/// same, bit by bit, whoever has read it.
fn read_shares(
    views: &[PlannedView],
    ranks: &Ranks,
    read: impl Fn(&PlannedView) -> Result<ReadView> + Sync + Send,
    arrived: impl Fn() + Sync + Send,
) -> Result<Vec<ReadView>> {
    let said = ranks.join_lists(&[to_bytes(&views.len())?], ranks.size())?;
    if said.iter().any(|other| *other != said[0]) {
        return Err(other_data("numbers of views"));
    }
    let plan = SharedReading { views, ranks, at_a_time: AT_A_TIME.max(ranks.size()) };
    let read = |view: usize| {
        let (mut loaded, look) = read(&views[view])?;
        loaded.record.photograph.iter_mut().for_each(|photograph| photograph.set_keeper(plan.keeper(view)));
        Ok((loaded, look))
    };
    let accept = |view, received| plan.accept(view, received).inspect(|_| arrived());
    let mut all = Vec::with_capacity(views.len());
    for start in (0..views.len()).step_by(plan.at_a_time) {
        let end = views.len().min(start + plan.at_a_time);
        all.extend(exchange(start..end, ranks, read, |view, read| plan.send(view, read), accept)?);
    }
    Ok(all)
}

/// Who reads which view, and who keeps its photograph.
struct SharedReading<'a> {
    views: &'a [PlannedView],
    ranks: &'a Ranks,
    /// Views that are read before the processes exchange them.
    at_a_time: usize,
}

impl SharedReading<'_> {
    /// The process that keeps the pixels of a view: that which reads it, or of a test view the first.
    fn keeper(&self, view: usize) -> u32 {
        if self.views[view].split() == Split::Test {
            return 0;
        }
        let start = view / self.at_a_time * self.at_a_time;
        let (count, size) = (self.at_a_time.min(self.views.len() - start), self.ranks.size());
        let reader = (0..size).find(|rank| share(count, 1, *rank, size).contains(&(view - start)));
        reader.unwrap_or(0) as u32
    }

    fn keeps(&self, view: usize) -> bool {
        self.keeper(view) == self.ranks.rank() as u32
    }

    /// The bytes of a view that this process has read, as those get it that have not; and what stays here of it.
    fn send(&self, view: usize, (mut loaded, look): ReadView) -> Result<(Vec<u8>, ReadView)> {
        let kept_here = if self.keeps(view) { take_pixels(&mut loaded) } else { None };
        let bytes = to_bytes(&Ok::<_, String>((&loaded, &look)))?;
        match kept_here {
            Some(photograph) => loaded.record.photograph = Some(photograph),
            None => _ = take_pixels(&mut loaded),
        }
        Ok((bytes, (loaded, look)))
    }

    /// What stays here of a view that another process has read.
    fn accept(&self, view: usize, (mut loaded, look): ReadView) -> Result<ReadView> {
        let planned = &self.views[view];
        if loaded.record.name != planned.name() {
            return Err(other_data(planned.name()));
        }
        if !self.keeps(view) {
            take_pixels(&mut loaded);
        }
        loaded.share_tables(planned);
        Ok((loaded, look))
    }
}

/// Takes the photograph of a view out, and leaves what is known of it beside its pixels.
fn take_pixels(view: &mut LoadedView) -> Option<Photograph> {
    let photograph = view.record.photograph.as_mut()?;
    let rest = photograph.without_its_pixels();
    Some(std::mem::replace(photograph, rest))
}

/// What `read` makes of each of some items: a share of them is read here, and what others have read goes through `accept`. `send` says what bytes these get,
/// and what stays here.
///
/// What one process cannot read, the others try to, so that all end with the error of the first such item.
fn exchange<T: Serialize + DeserializeOwned + Send>(
    items: Range<usize>,
    ranks: &Ranks,
    read: impl Fn(usize) -> Result<T> + Sync + Send,
    send: impl Fn(usize, T) -> Result<(Vec<u8>, T)> + Sync + Send,
    accept: impl Fn(usize, T) -> Result<T> + Sync + Send,
) -> Result<Vec<T>> {
    let share = ranks.share(items.len(), 1);
    let own = items.start + share.start..items.start + share.end;
    let packed = |item: usize| match read(item) {
        Ok(value) => send(item, value).map(|(bytes, value)| (bytes, Ok(value))),
        Err(error) => Ok((to_bytes(&Err::<T, _>(error.to_string()))?, Err(error))),
    };
    let packed: Vec<Result<(Vec<u8>, Result<T>)>> = own.clone().into_par_iter().map(packed).collect();
    let packed: Vec<(Vec<u8>, Result<T>)> = packed.into_iter().collect::<Result<_>>()?;
    let (bytes, values): (Vec<Vec<u8>>, Vec<Result<T>>) = packed.into_iter().unzip();
    let lists = ranks.join_lists(&bytes, items.len())?;
    drop(bytes);
    // All know by now whether one of them is asked to stop.
    check_interrupted()?;
    let received = |item: usize| match from_bytes(&lists[item - items.start]) {
        Ok(Ok(value)) => accept(item, value),
        Ok(Err(problem)) => read(item).and_then(|_| Err(not_there(problem))),
        Err(_) => Err(other_data(&format!("number {} as it was sent", item + 1))),
    };
    let of = |items: Range<usize>| items.into_par_iter().map(received).collect::<Vec<Result<T>>>();
    let (before, after) = (of(items.start..own.start), of(own.end..items.end));
    before.into_iter().chain(values).chain(after).collect()
}

/// What another process has told, where this one finds nothing wrong.
fn not_there(problem: String) -> Error {
    Error::run("another process cannot read a photograph", problem)
}

/// What was received is of another data set.
fn other_data(what: &str) -> Error {
    let problem =
        format!("the processes have different data sets, or programs of different versions ({what})");
    Error::run("sending photographs between processes", problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::color::linear_from_srgb;
    use crate::ranks::threads::ThreadRank;
    use glam::Vec3;
    use std::sync::Arc;

    /// What each of three processes gets of items, four at a time. Those that `is_missing` says of a process are not there for it, and those from `accepted` on are
    /// of other data.
    fn by_three(
        count: usize,
        is_missing: fn(usize, usize) -> bool,
        accepted: usize,
    ) -> Vec<Result<Vec<String>>> {
        let read_by = |rank: ThreadRank| {
            let ranks = Ranks::new(Arc::new(rank));
            let read = |item: usize| {
                let text = format!("item {item}");
                if is_missing(ranks.rank(), item) { Err(Error::run(text, "is not there")) } else { Ok(text) }
            };
            let accept = |item: usize, text: String| {
                if item < accepted { Ok(text) } else { Err(other_data(&text)) }
            };
            let send = |_, text: String| Ok((to_bytes(&Ok::<_, String>(&text))?, text));
            let mut all = Vec::new();
            for start in (0..count).step_by(4) {
                all.extend(exchange(start..count.min(start + 4), &ranks, read, send, accept)?);
            }
            Ok(all)
        };
        std::thread::scope(|scope| {
            let threads: Vec<_> =
                ThreadRank::group(3).into_iter().map(|rank| scope.spawn(move || read_by(rank))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        })
    }

    #[test]
    fn all_have_all_items_in_order_after_several_exchanges() {
        let expected: Vec<String> = (0..10).map(|item| format!("item {item}")).collect();
        for all in by_three(10, |_, _| false, 10) {
            assert_eq!(all.unwrap(), expected);
        }
    }

    #[test]
    fn all_end_with_the_error_of_the_first_item_that_is_not_there() {
        for all in by_three(10, |_, item| [6, 5, 9].contains(&item), 10) {
            assert_eq!(all.unwrap_err().to_string(), "item 5: is not there");
        }
    }

    #[test]
    fn what_only_one_process_cannot_read_is_told_by_all() {
        // The last process has the last item of four.
        let all = by_three(4, |rank, item| rank == 2 && item == 3, 4);
        let texts: Vec<String> = all.into_iter().map(|all| all.unwrap_err().to_string()).collect();
        let told = "another process cannot read a photograph: item 3: is not there";
        assert_eq!(texts, [told, told, "item 3: is not there"]);
    }

    #[test]
    fn an_item_of_other_data_is_told_by_those_that_receive_it() {
        let all = by_three(4, |_, _| false, 3);
        let told =
            all.iter().filter(|all| all.as_ref().is_err_and(|error| error.to_string().contains("item 3")));
        assert_eq!(told.count(), 2);
    }

    /// A data set of `count` views, every fifth of which is held out.
    fn data_set(count: usize) -> (tempfile::TempDir, Scene) {
        let folder = tempfile::tempdir().unwrap();
        for (split, rest) in [("train", 1..5), ("test", 0..1)] {
            let frame = |view: usize| {
                let picture = image::RgbaImage::from_pixel(8, 8, image::Rgba([90, 120, view as u8, 255]));
                picture.save(folder.path().join(format!("view_{view}.png"))).unwrap();
                serde_json::json!({
                    "file_path": format!("./view_{view}"),
                    "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]],
                })
            };
            let of_split = (0..count).filter(|view| rest.contains(&(view % 5)));
            let frames: Vec<_> = of_split.map(frame).collect();
            let cameras = serde_json::json!({ "camera_angle_x": 0.7, "frames": frames });
            let path = folder.path().join(format!("transforms_{split}.json"));
            std::fs::write(path, cameras.to_string()).unwrap();
        }
        let text = format!(
            "Scene(version: 1, surface: Sphere(radius: 0.5), views: Dataset(path: {:?}), passes: [Fit()])",
            folder.path()
        );
        let path = folder.path().join("scene.ron");
        std::fs::write(&path, text).unwrap();
        let scene = crate::scene::load(&path, &crate::scene::LoadOptions::default()).unwrap().scene;
        (folder, scene)
    }

    /// Name and split of a view, who keeps its photograph, and a pixel of it if it is here.
    type KeptView = (String, Split, u32, Option<Vec3>);

    /// The views of a data set as three processes have them.
    fn kept_by_three(open: &OpenScene) -> Vec<Vec<KeptView>> {
        let read_by = |rank: ThreadRank| {
            let ranks = Ranks::new(Arc::new(rank));
            let read = |view: &PlannedView| Ok((open.load(view)?, None));
            let all = read_shares(&open.views, &ranks, read, || {}).unwrap();
            let kept = |(loaded, _): ReadView| {
                let photograph = loaded.record.photograph.unwrap();
                let pixel = photograph.has_pixels().then(|| photograph.radiance(9));
                (loaded.record.name, loaded.record.split, photograph.keeper().unwrap(), pixel)
            };
            all.into_iter().map(kept).collect()
        };
        std::thread::scope(|scope| {
            let read_by = &read_by;
            let threads: Vec<_> =
                ThreadRank::group(3).into_iter().map(|rank| scope.spawn(move || read_by(rank))).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        })
    }

    #[test]
    fn each_photograph_is_in_the_memory_of_one_process() {
        let (_folder, scene) = data_set(83);
        let open = OpenScene::new(&scene, None).unwrap().unwrap();
        assert_eq!(open.views.len(), 83);
        let by_rank = kept_by_three(&open);
        let mut kept = [0; 3];
        for (view, (name, split, keeper, _)) in by_rank[0].iter().enumerate() {
            assert!(*split == Split::Train || *keeper == 0, "the first process keeps what is held out");
            for (rank, of_rank) in by_rank.iter().enumerate() {
                let (also, _, told, pixel) = &of_rank[view];
                assert_eq!((also, told), (name, keeper));
                // Its blue is the number in its name.
                let number: f32 = name.trim_start_matches("view_").parse().unwrap();
                let expected = (rank as u32 == *keeper).then(|| linear_from_srgb(number / 255.0));
                assert_eq!(pixel.map(|pixel| pixel.z), expected, "{name}, rank {rank}");
            }
            kept[*keeper as usize] += usize::from(*split == Split::Train);
        }
        assert!(kept.iter().all(|count| (15..30).contains(count)), "{kept:?}");
    }
}
