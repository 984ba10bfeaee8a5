#include "face_stream.h"

#include <algorithm>
#include <tuple>

namespace soft_volume::core::reader {
namespace {

/// An edge of a face, with its ends in ascending order.
struct Edge {
  std::uint32_t low;
  std::uint32_t high;
  std::uint32_t face;
  bool forward;  ///< the face runs from low to high

  bool isSameAs(const Edge& other) const { return low == other.low && high == other.high; }
};

void dropRepeatedVertices(Faces& faces) {
  for (std::vector<std::uint32_t>& face : faces) {
    face.erase(std::unique(face.begin(), face.end()), face.end());
    while (face.size() > 1 && face.front() == face.back())
      face.pop_back();
  }
  const auto is_flat = [](const std::vector<std::uint32_t>& face) { return face.size() < 3; };
  faces.erase(std::remove_if(faces.begin(), faces.end(), is_flat), faces.end());
}

std::vector<Edge> sortedEdges(const Faces& faces) {
  std::vector<Edge> edges;
  for (std::uint32_t f = 0; f < faces.size(); ++f) {
    for (std::size_t i = 0; i < faces[f].size(); ++i) {
      const std::uint32_t from = faces[f][i];
      const std::uint32_t to = faces[f][(i + 1) % faces[f].size()];
      edges.push_back({std::min(from, to), std::max(from, to), f, from < to});
    }
  }
  std::sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) {
    return std::tie(a.low, a.high, a.face) < std::tie(b.low, b.high, b.face);
  });
  return edges;
}

/// Calls visit(first, end) for the edges between the same two vertices.
template <typename Visit>
void forEachSharedEdge(const std::vector<Edge>& edges, const Visit& visit) {
  for (auto first = edges.begin(); first != edges.end();) {
    const auto end = std::find_if(first, edges.end(), [&](const Edge& edge) { return !edge.isSameAs(*first); });
    visit(first, end);
    first = end;
  }
}

bool isClosed(const std::vector<Edge>& edges) {
  bool closed = !edges.empty();
  forEachSharedEdge(edges, [&](auto first, auto end) { closed &= (end - first) % 2 == 0; });
  return closed;
}

/// Every edge is run through as often in one direction as in the other.
bool isConsistent(const std::vector<Edge>& edges) {
  bool consistent = true;
  forEachSharedEdge(edges, [&](auto first, auto end) {
    consistent &= 2 * std::count_if(first, end, [](const Edge& edge) { return edge.forward; }) == end - first;
  });
  return consistent;
}

/// Two faces that share an edge; `opposed` where they run through it in opposite directions, as they should.
struct Link {
  std::uint32_t face;
  bool opposed;
};

std::vector<std::vector<Link>> linksOf(const std::vector<Edge>& edges, std::size_t faces) {
  std::vector<std::vector<Link>> links(faces);
  forEachSharedEdge(edges, [&](auto first, auto end) {
    if (end - first != 2)
      return;  // where parts of a cell touch in an edge nothing follows for their sides
    const bool opposed = first[0].forward != first[1].forward;
    links[first[0].face].push_back({first[1].face, opposed});
    links[first[1].face].push_back({first[0].face, opposed});
  });
  return links;
}

/// Six times the volume that faces enclose when they are seen counter-clockwise from outside.
double sixfoldVolume(const Faces& faces, const std::vector<std::uint32_t>& chosen,
                     const std::function<Vector3(std::uint32_t)>& point) {
  const Vector3 origin = point(faces[chosen.front()].front());
  double sum = 0.0;
  for (const std::uint32_t f : chosen) {
    const Vector3 a = point(faces[f][0]) - origin;
    for (std::size_t i = 1; i + 1 < faces[f].size(); ++i)
      sum += a.dot((point(faces[f][i]) - origin).cross(point(faces[f][i + 1]) - origin));
  }
  return sum;
}

void turn(std::vector<std::uint32_t>& face) {
  std::reverse(face.begin() + 1, face.end());
}

/// All faces that hang together with `first`, turned to its side.
std::vector<std::uint32_t> turnAlike(std::uint32_t first, const std::vector<std::vector<Link>>& links,
                                     std::vector<bool>& seen, Faces& faces) {
  std::vector<std::uint32_t> part = {first};
  std::vector<bool> turned(faces.size(), false);
  seen[first] = true;
  for (std::size_t next = 0; next < part.size(); ++next) {
    const std::uint32_t from = part[next];
    for (const Link& link : links[from]) {
      if (seen[link.face])
        continue;
      seen[link.face] = true;
      turned[link.face] = turned[from] == link.opposed;
      if (turned[link.face])
        turn(faces[link.face]);
      part.push_back(link.face);
    }
  }
  return part;
}

void turnOutward(const std::vector<std::uint32_t>& part, const std::function<Vector3(std::uint32_t)>& point,
                 Faces& faces) {
  if (sixfoldVolume(faces, part, point) >= 0.0)
    return;
  for (const std::uint32_t f : part)
    turn(faces[f]);
}

std::vector<std::uint32_t> allOf(const Faces& faces) {
  std::vector<std::uint32_t> all(faces.size());
  for (std::uint32_t f = 0; f < all.size(); ++f)
    all[f] = f;
  return all;
}

}  // namespace

bool closeFaces(Faces& faces, const std::function<Vector3(std::uint32_t)>& point) {
  dropRepeatedVertices(faces);
  const std::vector<Edge> edges = sortedEdges(faces);
  if (!isClosed(edges))
    return false;
  if (isConsistent(edges)) {
    turnOutward(allOf(faces), point, faces);
    return true;
  }
  const auto links = linksOf(edges, faces.size());
  std::vector<bool> seen(faces.size(), false);
  for (std::uint32_t f = 0; f < faces.size(); ++f) {
    if (!seen[f])
      turnOutward(turnAlike(f, links, seen, faces), point, faces);
  }
  return true;
}

void appendFaceStream(const Faces& faces, std::vector<std::uint32_t>& stream) {
  stream.push_back(static_cast<std::uint32_t>(faces.size()));
  for (const std::vector<std::uint32_t>& face : faces) {
    stream.push_back(static_cast<std::uint32_t>(face.size()));
    stream.insert(stream.end(), face.begin(), face.end());
  }
}

}  // namespace soft_volume::core::reader
