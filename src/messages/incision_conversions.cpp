#include <soft_volume/IncisionState.h>

#include <utility>

#include "flat_arrays.h"
#include "soft_volume/common/error.h"
#include "soft_volume/messages/conversions.h"

namespace soft_volume {
namespace {

void require(bool condition, const char* problem) {
  if (!condition)
    throw core::InputError(std::string("the incisions of a checkpoint: ") + problem);
}

boost::array<geometry_msgs::Point, 2> toPoints(const core::Vector3& tip, const core::Vector3& heel) {
  return {{toPoint(tip), toPoint(heel)}};
}

std::array<core::Vector3, 2> fromPoints(const boost::array<geometry_msgs::Point, 2>& points) {
  return {fromPoint(points[0]), fromPoint(points[1])};
}

core::Stroke::Edge toEdge(const std::array<core::Vector3, 2>& points) {
  return {points[0], points[1]};
}

StrokeState toMessage(const std::string& tool_id, const core::TissueStroke& stroke) {
  StrokeState message;
  message.tool_id = tool_id;
  for (const core::Stroke::Edge& edge : stroke.stroke.edges) {
    message.edges.push_back(toPoint(edge.tip));
    message.edges.push_back(toPoint(edge.heel));
  }
  message.blade = toPoints(stroke.stroke.blade.tip, stroke.stroke.blade.heel);
  message.has_joint = static_cast<std::uint8_t>(stroke.stroke.has_joint);
  message.lips_edge = toPoints(stroke.stroke.lips.edge_m[0], stroke.stroke.lips.edge_m[1]);
  for (const auto& [piece, side] : stroke.stroke.lips.side_of_piece) {
    message.lip_pieces.push_back(piece);
    message.lip_sides.push_back(static_cast<std::int8_t>(side));
  }
  message.lips_start = toPoints(stroke.stroke.lips.start_m[0], stroke.stroke.lips.start_m[1]);
  message.lips_pieces_seen = stroke.stroke.lips.pieces_seen;
  message.joint_offsets = toPoints(stroke.joint[0].offset_m, stroke.joint[1].offset_m);
  for (std::size_t end = 0; end < 2; ++end) {
    const core::TissuePlace& place = stroke.joint[end];
    message.joint_counts[end] = static_cast<std::uint32_t>(place.vertices.size());
    message.joint_vertices.insert(message.joint_vertices.end(), place.vertices.begin(), place.vertices.end());
    message.joint_weights.insert(message.joint_weights.end(), place.weights.begin(), place.weights.end());
  }
  return message;
}

std::array<core::TissuePlace, 2> jointOf(const StrokeState& message) {
  const std::size_t first = message.joint_counts[0];
  const std::size_t count = first + message.joint_counts[1];
  require(message.joint_vertices.size() == count && message.joint_weights.size() == count,
          "joint_vertices or joint_weights does not fit joint_counts");
  const auto split = static_cast<std::ptrdiff_t>(first);
  const auto& vertices = message.joint_vertices;
  const auto& weights = message.joint_weights;
  const std::array<core::Vector3, 2> offsets = fromPoints(message.joint_offsets);
  return {core::TissuePlace{
              offsets[0], {vertices.begin(), vertices.begin() + split}, {weights.begin(), weights.begin() + split}},
          core::TissuePlace{
              offsets[1], {vertices.begin() + split, vertices.end()}, {weights.begin() + split, weights.end()}}};
}

core::TissueStroke fromMessage(const StrokeState& message) {
  core::TissueStroke stroke;
  require(message.edges.size() % 2 == 0, "edges has a tip without a heel");
  for (std::size_t n = 0; n < message.edges.size(); n += 2)
    stroke.stroke.edges.push_back({fromPoint(message.edges[n]), fromPoint(message.edges[n + 1])});
  stroke.stroke.blade = toEdge(fromPoints(message.blade));
  stroke.stroke.has_joint = message.has_joint != 0;
  stroke.stroke.lips.edge_m = fromPoints(message.lips_edge);
  stroke.stroke.lips.start_m = fromPoints(message.lips_start);
  stroke.stroke.lips.pieces_seen = message.lips_pieces_seen;
  require(message.lip_pieces.size() == message.lip_sides.size(), "lip_pieces and lip_sides do not fit");
  for (std::size_t n = 0; n < message.lip_pieces.size(); ++n)
    stroke.stroke.lips.side_of_piece[message.lip_pieces[n]] = message.lip_sides[n];
  stroke.joint = jointOf(message);
  return stroke;
}

void addFaces(const std::vector<core::CutMesh::Face>& faces, IncisionState& message) {
  if (faces.empty())
    return;
  message.face_offsets.push_back(0);
  for (const core::CutMesh::Face& face : faces) {
    message.face_vertices.insert(message.face_vertices.end(), face.loop.begin(), face.loop.end());
    message.face_offsets.push_back(static_cast<std::uint32_t>(message.face_vertices.size()));
    message.face_pieces.insert(message.face_pieces.end(), face.pieces.begin(), face.pieces.end());
    message.face_opened.push_back(static_cast<std::uint8_t>(face.opened));
  }
}

std::vector<core::CutMesh::Face> facesOf(const IncisionState& message) {
  const auto& offsets = message.face_offsets;
  const auto pieces = rows<2>(message.face_pieces, "face_pieces");
  require(offsets.size() == (pieces.empty() ? 0 : pieces.size() + 1) && message.face_opened.size() == pieces.size(),
          "face_offsets, face_pieces and face_opened do not fit");
  std::vector<core::CutMesh::Face> faces(pieces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    require(offsets[f] <= offsets[f + 1] && offsets[f + 1] <= message.face_vertices.size(),
            "face_offsets leaves face_vertices");
    faces[f].loop.assign(message.face_vertices.begin() + offsets[f], message.face_vertices.begin() + offsets[f + 1]);
    faces[f].pieces = pieces[f];
    faces[f].opened = message.face_opened[f] != 0;
  }
  return faces;
}

}  // namespace

IncisionState toMessage(const core::IncisionState& state) {
  IncisionState message;
  message.cells = flatten(state.cells);
  message.parent_cells = state.parent_cells;
  message.shares = state.shares;
  message.surface_shares = flatten(state.surface_shares);
  message.rest_stretch = flatten(state.rest_stretch);
  message.face_neighbours = flatten(state.face_neighbours);
  message.cut_faces = flatten(state.cut_faces);
  message.origin_vertices = state.origin_vertices;
  message.fixed = state.fixed;
  for (const core::CutMesh::Source& source : state.sources) {
    message.vertex_ends.insert(message.vertex_ends.end(), {source.a, source.b});
    message.vertex_shares.push_back(source.share);
  }
  addFaces(state.faces, message);
  for (const core::CutMesh::Piece& piece : state.pieces) {
    message.piece_cells.push_back(piece.cell);
    message.piece_origins.push_back(piece.origin);
  }
  message.piece_carriers = state.cells_of_pieces;
  for (const auto& [tool_id, stroke] : state.strokes)
    message.strokes.push_back(toMessage(tool_id, stroke));
  return message;
}

core::IncisionState fromMessage(const IncisionState& message) {
  core::IncisionState state;
  state.cells = rows<8>(message.cells, "cells");
  state.parent_cells = message.parent_cells;
  state.shares = message.shares;
  state.surface_shares = rows<6>(message.surface_shares, "surface_shares");
  state.rest_stretch = unflatten(message.rest_stretch, "rest_stretch");
  state.face_neighbours = rows<6>(message.face_neighbours, "face_neighbours");
  state.cut_faces = rows<6>(message.cut_faces, "cut_faces");
  state.origin_vertices = message.origin_vertices;
  state.fixed = message.fixed;
  const auto ends = rows<2>(message.vertex_ends, "vertex_ends");
  require(ends.size() == message.vertex_shares.size(), "vertex_ends and vertex_shares do not fit");
  for (std::size_t n = 0; n < ends.size(); ++n)
    state.sources.push_back({ends[n][0], ends[n][1], message.vertex_shares[n]});
  state.faces = facesOf(message);
  require(message.piece_cells.size() == message.piece_origins.size(), "piece_cells and piece_origins do not fit");
  for (std::size_t n = 0; n < message.piece_cells.size(); ++n)
    state.pieces.push_back({message.piece_cells[n], {}, message.piece_origins[n]});
  state.cells_of_pieces = message.piece_carriers;
  for (const StrokeState& stroke : message.strokes)
    state.strokes[stroke.tool_id] = fromMessage(stroke);
  return state;
}

}  // namespace soft_volume
