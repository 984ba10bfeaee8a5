#pragma once

#include <gtest/gtest.h>

#include "incision/embedded_block.h"
#include "soft_volume/incision/mesh_topology.h"

namespace soft_volume::core {

/// Of a volume that a block of cells of kH lies in.
inline VolumeGeometry volumeAround(int cells) {
  VolumeGeometry geometry;
  geometry.dims = {2 * cells + 1, 3 * cells, 2 * cells};
  geometry.spacing_m = Vector3(0.5, 0.4, 0.7) * kH;
  return geometry;
}

/// Field by field, bit for bit.
inline void expectSame(const Topology& a, const Topology& b) {
  ASSERT_EQ(a.session, b.session);
  ASSERT_EQ(a.revision, b.revision);
  ASSERT_EQ(a.rest_positions, b.rest_positions);
  ASSERT_EQ(a.texture_coordinates, b.texture_coordinates);
  ASSERT_EQ(a.fixed, b.fixed);
  ASSERT_EQ(a.origin_vertices, b.origin_vertices);
  ASSERT_EQ(a.cell_types, b.cell_types);
  ASSERT_EQ(a.cell_offsets, b.cell_offsets);
  ASSERT_EQ(a.connectivity, b.connectivity);
  ASSERT_EQ(a.parent_cells, b.parent_cells);
  ASSERT_EQ(a.materials, b.materials);
  ASSERT_EQ(a.face_neighbours, b.face_neighbours);
  ASSERT_EQ(a.cut_faces, b.cut_faces);
}

}  // namespace soft_volume::core
