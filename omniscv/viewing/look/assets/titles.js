// Layers in their order, as people read them; others follow by their names.

const TITLES = {
  lit: "Colour", labels: "Objects", classes: "Classes", object_mask: "Mask", depth: "Depth", normals: "Normals",
  depth_error: "Depth error", label_edge: "Label edges", unsure: "Unsure", occluded: "Hidden",
};
const ORDER = Object.keys(TITLES);
const titleOf = (name) => TITLES[name] ?? name.replaceAll("_", " ");
