#pragma once

#include <xmlrpcpp/XmlRpcValue.h>

#include <optional>
#include <string>

namespace soft_volume {

/// Where an XML-RPC server of the graph listens: the master's, a node's.
struct XmlRpcServerAddress {
  std::string host;
  int port = 0;
};

enum class Answer {
  kAccepts,  ///< a connection
  kRefuses,  ///< the host is there, and nobody listens
  kNone      ///< within the limit
};

/// Tries to connect, and closes again. Blocks for `limit_s` at most, and as long as the host's name takes to resolve.
Answer probe(const XmlRpcServerAddress& address, double limit_s);

/// Calls a function of the master's or a node's API; the payload, or null when it fails or takes longer than the limit.
/// roscpp's own calls wait for ever when the network is gone.
std::optional<XmlRpc::XmlRpcValue> callApi(const XmlRpcServerAddress& address, const char* function,
                                           const XmlRpc::XmlRpcValue& arguments, double limit_s);

}  // namespace soft_volume
