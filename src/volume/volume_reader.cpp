#include "soft_volume/volume/volume_reader.h"

#include <utility>

#include "reader_client.h"
#include "reader_protocol.h"

namespace soft_volume::core {
namespace {

VolumeGeometry geometryOf(const VolumeReply& reply) {
  VolumeGeometry geometry;
  geometry.dims = Eigen::Map<const Vector3i>(reply.dims);
  geometry.spacing_m = Eigen::Map<const Vector3>(reply.spacing_m);
  geometry.origin_m = Eigen::Map<const Vector3>(reply.origin_m);
  geometry.direction = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(reply.direction);
  return geometry;
}

Volume receiveVolume(ReaderClient& client) {
  const auto reply = client.receiveReply<VolumeReply>(kVolumeMagic);
  if (reply.scalar_type > static_cast<std::uint32_t>(ScalarType::kFloat64)) {
    client.refuse("the reader's answer has an unknown scalar type");
  }
  auto data = client.receive<std::uint8_t>(reply.byte_count);
  return Volume(geometryOf(reply), static_cast<ScalarType>(reply.scalar_type), std::move(data));
}

}  // namespace

Volume readVolume(const std::string& path, const ReadLimits& limits) {
  Volume volume;
  readInChild(path, kReadVolume, {}, limits, [&](ReaderClient& client) { volume = receiveVolume(client); });
  return volume;
}

}  // namespace soft_volume::core
