#include "soft_volume/grid/grid_reader.h"

#include <utility>

#include "volume/reader_client.h"
#include "volume/reader_protocol.h"

namespace soft_volume::core {
namespace {

GridArray receiveArray(ReaderClient& client) {
  const ArrayReply reply = client.receive<ArrayReply>(1).front();
  GridArray array;
  array.name = client.receiveText(reply.name_bytes);
  array.place = reply.place == 0 ? GridArray::Place::kPoints : GridArray::Place::kCells;
  array.components = static_cast<int>(reply.components);
  array.range = {reply.range[0], reply.range[1]};
  return array;
}

/// In the order of reader_protocol.h.
void receiveCells(ReaderClient& client, const GridReply& reply, IrregularGrid& grid) {
  grid.points = client.receive<Vector3f>(reply.points);
  grid.cell_types = client.receive<CellType>(reply.cells);
  grid.cell_offsets = client.receive<std::uint32_t>(reply.cells + 1);
  grid.connectivity = client.receive<std::uint32_t>(reply.connectivity);
  if (reply.place == static_cast<std::uint32_t>(GridArray::Place::kPoints)) {
    grid.point_scalars = client.receive<float>(reply.points);
  } else {
    grid.cell_scalars = client.receive<float>(reply.cells);
  }
}

GridFile receiveGrid(ReaderClient& client) {
  const auto reply = client.receiveReply<GridReply>(kGridMagic);
  GridFile file;
  receiveCells(client, reply, file.grid);
  for (std::uint32_t i = 0; i < reply.arrays; ++i)
    file.arrays.push_back(receiveArray(client));
  for (std::uint32_t i = 0; i < reply.notes; ++i)
    file.notes.push_back(client.receiveText(client.receive<std::uint32_t>(1).front()));
  file.taken = reply.taken;
  if (file.taken >= file.arrays.size())
    client.refuse("the reader's answer names no array");
  file.grid.validate();
  return file;
}

}  // namespace

GridFile readGrid(const std::string& path, const GridReadOptions& options, const ReadLimits& limits) {
  GridFile file;
  readInChild(path, kReadGrid, {options.solution, options.array, std::to_string(options.component)}, limits,
              [&](ReaderClient& client) { file = receiveGrid(client); });
  return file;
}

}  // namespace soft_volume::core
