//! A page with the exported object under its light, ready to be put on a site.

/// Its file name.
pub const PAGE: &str = "model-viewer.html";

/// Where the element of the page comes from, a server of others.
const SCRIPT: &str = "https://ajax.googleapis.com/ajax/libs/model-viewer/4.0.0/model-viewer.min.js";

/// The page that shows `mesh` under `light`, files beside it.
pub fn page(mesh: &str, light: Option<&str>) -> String {
    let light = light.map(|light| format!("\n      environment-image=\"{light}\"")).unwrap_or_default();
    format!(
        r#"<!DOCTYPE html>
<html lang="en">
  <head>
    <meta charset="utf-8">
    <meta name="viewport" content="width=device-width, initial-scale=1">
    <title>The object under its light</title>
    <!-- The only thing that is not beside this file: the <model-viewer> element, from a server of Google. To do without
         it, save the script beside this file and name it here. -->
    <script type="module" src="{SCRIPT}"></script>
    <style>
      html, body, model-viewer {{ width: 100%; height: 100%; margin: 0; }}
    </style>
  </head>
  <body>
    <!-- Browsers load the mesh and the light from a server only, not from the disk: python3 -m http.server, for one.
         tone-mapping="none" shows colors as they are computed, clipped at white. -->
    <model-viewer
      src="{mesh}"{light}
      alt="The object"
      exposure="1"
      tone-mapping="none"
      shadow-intensity="0"
      camera-controls
      touch-action="pan-y"></model-viewer>
  </body>
</html>
"#
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_names_its_files_and_one_script() {
        let text = page("mesh.glb", Some("light.hdr"));
        assert!(text.contains("src=\"mesh.glb\"") && text.contains("environment-image=\"light.hdr\""));
        assert_eq!(text.matches("http").count(), 2, "one address, and the word http.server");
        assert!(!page("mesh.glb", None).contains("environment-image"));
    }
}
