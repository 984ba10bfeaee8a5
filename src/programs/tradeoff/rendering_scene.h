#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "blunt_fin.h"
#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/renderer.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// Where a scene is looked at from.
struct RenderingView {
  std::string name;
  std::function<Camera(int width, int height)> camera;
};

/// What is drawn, stated without a back end: a grid with scalars, or a volume on the cells of a topology.
struct RenderingScene {
  std::string name;
  std::string description;               ///< full sentences
  IrregularGrid grid;                    ///< empty where there is a volume
  Topology topology;                     ///< of the volume
  std::shared_ptr<const Volume> volume;  ///< null where the grid has scalars
  std::vector<Vector3f> positions;       ///< per vertex, volume frame, metres: as it is drawn
  std::vector<NamedFunction> functions;
  std::vector<RenderingView> views;
  int slices = 100;  ///< that its figures are usually given for
};

/// A hexahedral grid of about `cells` cells that winds around an obstacle, as a grid of flow does: curved, warped,
/// sheared, nine times finer at the obstacle's wall than far from it, with a front across its cells.
RenderingScene curvilinearScene(std::size_t cells);

/// The MRI of a head in the sample data: 129 x 200 x 79 voxels of it on a lattice of 10 x 20 x 16 cells that is bent
/// and squeezed. Null with a reason when the file or the reader is not there.
std::unique_ptr<RenderingScene> mriLatticeScene(std::string& why_not);

/// A view in parallel projection from `direction` (from the grid to the eye) in which the box fills 95 % of the image
/// from left to right or from top to bottom.
RenderingView parallelView(const std::string& name, const Box3& box, const Vector3& direction, const Vector3& up);

/// A back end with the scene's data, ready to draw. Throws as Renderer does.
std::unique_ptr<Renderer> makeRenderer(const RenderingScene& scene, Backend backend);

/// Positions after a touch in the middle of the view: a dent whose cells span a rectangle of `part` of the image, or as
/// near to it as the cells allow. All other positions keep their bits.
std::vector<Vector3f> touched(const RenderingScene& scene, const Camera& camera, double part);

/// Root mean square over the colour channels of those pixels that are not black in both, in 8-bit levels. Not rounded:
/// `image` and `reference` are premultiplied, so they are over black. Throws InputError when the sizes differ.
double rmseLevels(const Frame& image, const Frame& reference);

}  // namespace soft_volume::core
