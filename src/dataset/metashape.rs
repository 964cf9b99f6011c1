//! Metashape's layout: the XML file of its export "Export Cameras", beside `images/` (or the photographs themselves) and `masks/`.
//!
//! A camera of the file has a 4×4 world_from_camera with OpenCV axes, and a sensor with calibration: `f`, and, if they are
//! there, `cx`, `cy` (principal point from the image's middle), `b1`, `b2` (affinity and skew), all in pixels, `k1`, `k2`, `k3` and
//! `p1`, `p2`, which are OpenCV's p₂ and p₁. The world is that of the component or of the chunk, whose `transform` is applied: rotation,
//! translation, scale. Cameras without pose or calibration are left out. There is no test split: see
//! [`crate::dataset::DatasetOptions::hold_out`].

use crate::dataset::distortion::Distortion;
use crate::dataset::exports::Export;
use crate::dataset::lens::Lens;
use crate::dataset::load::read_text;
use crate::dataset::names::{ImageName, portable, quoted, shown};
use crate::dataset::photographs::{Photographs, view_of};
use crate::dataset::plan::Plan;
use crate::dataset::pose::Rigid;
use crate::error::{Error, Result};
use roxmltree::{Document, Node, ParsingOptions};
use std::path::Path;

/// Most elements, attributes and texts of a document.
const MOST_NODES: u32 = 20_000_000;
const EXPORT_HELP: &str = "Export it again: File, Export, Export Cameras, Agisoft XML.";

/// The file of cameras.
pub(super) const EXPORT: Export = Export {
    extension: "xml",
    mark: ".xml file with <document> and <chunk>",
    is_head: |head| head.contains("<document") && head.contains("<chunk"),
    help: EXPORT_HELP,
};

/// Plans all views, in the order of the file.
pub(super) fn plan(dir: &Path) -> Result<Plan> {
    let file = &EXPORT.only(dir)?;
    let text = read_text(file)?;
    let options = ParsingOptions { nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text.trim_start_matches('\u{feff}'), options);
    let document = document.map_err(|error| {
        let place = format!("line {}", error.pos().row);
        Error::input(file, place, format!("this is not XML: {error}"), EXPORT_HELP)
    })?;
    let xml = Xml { file, document: &document };
    let mut chunks = document.root_element().children().filter(|node| node.has_tag_name("chunk"));
    let chunk = chunks.next().ok_or_else(|| xml.wrong(document.root_element(), "there is no <chunk>"))?;
    if let Some(second) = chunks.next() {
        return Err(xml.wrong(second, "there is more than one chunk"));
    }
    xml.plan_chunk(dir, chunk)
}

/// A document and where it comes from.
struct Xml<'a, 'input> {
    file: &'a Path,
    document: &'a Document<'input>,
}

/// The transform of a chunk or component: world = scale · rotation · x + translation.
#[derive(Clone, Copy)]
struct Similarity {
    rigid: Rigid,
    scale: f64,
}

impl<'a, 'input: 'a> Xml<'a, 'input> {
    fn wrong(&self, node: Node<'a, 'input>, problem: impl Into<String>) -> Error {
        Error::input(self.file, self.place(node), problem, EXPORT_HELP)
    }

    fn place(&self, node: Node<'a, 'input>) -> String {
        format!("line {}", self.document.text_pos_at(node.range().start).row)
    }

    fn plan_chunk(&self, dir: &Path, chunk: Node<'a, 'input>) -> Result<Plan> {
        let photographs = Photographs::find(dir, &["images", "image", ""])?;
        let (mut views, mut left_out) = (Vec::new(), Vec::new());
        let groups = chunk.children().filter(|node| node.has_tag_name("cameras"));
        for camera in groups.flat_map(|group| group.descendants()).filter(|node| node.has_tag_name("camera"))
        {
            let label =
                camera.attribute("label").ok_or_else(|| self.wrong(camera, "the camera has no label"))?;
            let is_off = matches!(camera.attribute("enabled"), Some("0" | "false"));
            let Some(transform) = child(camera, "transform").filter(|_| !is_off) else {
                left_out.push(label);
                continue;
            };
            let world_from_camera = self.pose(chunk, camera, transform)?;
            let lens = self.lens(chunk, camera)?;
            let place = format!("camera {}", quoted(label));
            let (image, mask) = photographs.called(ImageName::new(&portable(label), self.file, &place)?)?;
            views.push(view_of(image, mask, self.file, place, lens, world_from_camera));
        }
        if views.is_empty() {
            return Err(self.wrong(chunk, "the chunk has no cameras with a pose"));
        }
        let mut notes = Vec::new();
        if let Some(first) = left_out.first() {
            let count = left_out.len();
            notes.push(format!(
                "{count} cameras have no pose or are disabled, and are left out (the first is {})",
                shown(first)
            ));
        } else {
            notes.extend(photographs.unused(&views));
        }
        Ok(Plan { views, notes })
    }

    /// World_from_camera.
    fn pose(
        &self,
        chunk: Node<'a, 'input>,
        camera: Node<'a, 'input>,
        transform: Node<'a, 'input>,
    ) -> Result<Rigid> {
        let rows: [f64; 16] = self.numbers(transform)?;
        let local = Rigid::from_rows(&rows)
            .map_err(|problem| self.wrong(transform, format!("the camera's transform {problem}")))?;
        let component = camera.attribute("component_id").and_then(|id| {
            let mut components = child(chunk, "components")?.children();
            components.find(|node| node.has_tag_name("component") && node.attribute("id") == Some(id))
        });
        let outer = component.and_then(|component| child(component, "transform"));
        let Some(outer) = outer.or_else(|| child(chunk, "transform")) else { return Ok(local) };
        let Similarity { rigid, scale } = self.similarity(outer)?;
        let translation = scale * (rigid.rotation * local.translation) + rigid.translation;
        if !translation.as_vec3().is_finite() {
            return Err(self.wrong(transform, "the camera's position is not finite in the world"));
        }
        let error = rigid.error.max(local.error);
        Ok(Rigid { rotation: rigid.rotation * local.rotation, translation, error })
    }

    fn similarity(&self, transform: Node<'a, 'input>) -> Result<Similarity> {
        let of = |name: &str| child(transform, name);
        let r: [f64; 9] = of("rotation")
            .map_or(Ok([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), |node| self.numbers(node))?;
        let t: [f64; 3] = of("translation").map_or(Ok([0.0; 3]), |node| self.numbers(node))?;
        let [scale] = of("scale").map_or(Ok([1.0]), |node| self.numbers(node))?;
        let rows =
            [r[0], r[1], r[2], t[0], r[3], r[4], r[5], t[1], r[6], r[7], r[8], t[2], 0.0, 0.0, 0.0, 1.0];
        let rigid = Rigid::from_rows(&rows)
            .map_err(|problem| self.wrong(transform, format!("the transform {problem}")))?;
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(
                self.wrong(transform, format!("the transform's scale is {scale}; it must be above 0"))
            );
        }
        Ok(Similarity { rigid, scale })
    }

    fn lens(&self, chunk: Node<'a, 'input>, camera: Node<'a, 'input>) -> Result<Lens> {
        let id = camera.attribute("sensor_id").unwrap_or("0");
        let mut sensors = child(chunk, "sensors").into_iter().flat_map(|sensors| sensors.children());
        let sensor = sensors.find(|node| node.has_tag_name("sensor") && node.attribute("id") == Some(id));
        let sensor = sensor.ok_or_else(|| self.wrong(camera, format!("there is no sensor {id}")))?;
        let all = || sensor.children().filter(|node| node.has_tag_name("calibration"));
        let adjusted = all().find(|node| node.attribute("class") == Some("adjusted"));
        let calibration = adjusted.or_else(|| all().next());
        let calibration =
            calibration.ok_or_else(|| self.wrong(sensor, format!("sensor {id} has no calibration")))?;
        for kind in [sensor.attribute("type"), calibration.attribute("type")].into_iter().flatten() {
            if !matches!(kind, "frame" | "brown") {
                let problem = format!("sensor {id} is of the type {kind}; only frame cameras can be read");
                let help = "Export undistorted photographs and their cameras.";
                return Err(Error::input(self.file, self.place(sensor), problem, help));
            }
        }
        let resolution = child(calibration, "resolution").or_else(|| child(sensor, "resolution"));
        let resolution = resolution.ok_or_else(|| self.wrong(sensor, "the sensor has no resolution"))?;
        let side = |name: &str| resolution.attribute(name).and_then(|text| text.parse::<u32>().ok());
        let (Some(width), Some(height)) = (side("width"), side("height")) else {
            return Err(self.wrong(resolution, "the width or the height is not a whole number"));
        };
        self.calibrated(calibration, [width, height])
    }

    /// The lens of a calibration: u = w/2 + cx + x (f + b1) + y b2, v = h/2 + cy + y f.
    fn calibrated(&self, calibration: Node<'a, 'input>, size: [u32; 2]) -> Result<Lens> {
        let value = |name: &str| -> Result<f64> {
            child(calibration, name).map_or(Ok(0.0), |node| self.numbers(node).map(|[value]| value))
        };
        if child(calibration, "f").is_none() {
            return Err(self.wrong(calibration, "the calibration has no focal length <f>"));
        }
        for name in ["k4", "p3", "p4"] {
            if value(name)? != 0.0 {
                let problem = format!("{name} is {}, which cannot be read", value(name)?);
                let help =
                    "Optimize the cameras without it, or export undistorted photographs and their cameras.";
                return Err(Error::input(self.file, self.place(calibration), problem, help));
            }
        }
        let (f, b1, skew) = (value("f")?, value("b1")?, value("b2")?);
        let middle = size.map(|side| 0.5 * f64::from(side));
        let center = [middle[0] + value("cx")?, middle[1] + value("cy")?];
        // Of OpenCV's coefficients the first is that of y's own square.
        let tangential = [value("p2")?, value("p1")?];
        let distortion = Distortion::brown_conrady([value("k1")?, value("k2")?, value("k3")?], tangential);
        Ok(Lens {
            size: Some(size),
            skew,
            distortion,
            resizable: true,
            ..Lens::pinhole([f + b1, f], center.map(Some))
        })
    }

    /// The finite numbers of an element's text.
    fn numbers<const N: usize>(&self, node: Node<'a, 'input>) -> Result<[f64; N]> {
        let name = node.tag_name().name();
        let words: Vec<&str> = node.text().unwrap_or_default().split_whitespace().collect();
        let numbers: Option<Vec<f64>> = words.iter().map(|word| word.parse().ok()).collect();
        let numbers = numbers.filter(|numbers| numbers.iter().all(|number| number.is_finite()));
        let numbers = numbers.ok_or_else(|| self.wrong(node, format!("<{name}> is not finite numbers")))?;
        let count = numbers.len();
        numbers.try_into().map_err(|_| self.wrong(node, format!("<{name}> has {count} numbers, not {N}")))
    }
}

fn child<'a, 'input: 'a>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}
