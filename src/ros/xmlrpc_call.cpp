#include "xmlrpc_call.h"

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>
#include <xmlrpcpp/XmlRpcClient.h>
#include <xmlrpcpp/XmlRpcException.h>

#include <cerrno>
#include <memory>

namespace soft_volume {
namespace {

/// The error of a connection that is being made, once it is known; ETIMEDOUT when the limit passes.
int connectionError(int socket, double limit_s) {
  pollfd wait{socket, POLLOUT, 0};
  if (::poll(&wait, 1, static_cast<int>(1e3 * limit_s)) <= 0)
    return ETIMEDOUT;
  int error = 0;
  socklen_t size = sizeof(error);
  return ::getsockopt(socket, SOL_SOCKET, SO_ERROR, &error, &size) == 0 ? error : errno;
}

int connectTo(const addrinfo& address, double limit_s) {
  const int descriptor = ::socket(address.ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (descriptor < 0)
    return errno;
  int error = ::connect(descriptor, address.ai_addr, address.ai_addrlen) == 0 ? 0 : errno;
  if (error == EINPROGRESS)
    error = connectionError(descriptor, limit_s);
  ::close(descriptor);
  return error;
}

/// A client whose calls end.
class Client : public XmlRpc::XmlRpcClient {
 public:
  explicit Client(const XmlRpcServerAddress& address) : XmlRpc::XmlRpcClient(address.host.c_str(), address.port, "/") {}

  bool call(const char* function, const XmlRpc::XmlRpcValue& arguments, XmlRpc::XmlRpcValue& result, double limit_s) {
    if (!executeNonBlock(function, arguments))
      return false;
    _disp.work(limit_s);
    return _connectionState == IDLE && parseResponse(result) && !isFault();
  }
};

}  // namespace

Answer probe(const XmlRpcServerAddress& address, double limit_s) {
  addrinfo hints{};
  hints.ai_family = AF_INET;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (::getaddrinfo(address.host.c_str(), std::to_string(address.port).c_str(), &hints, &found) != 0)
    return Answer::kNone;
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owner(found, &::freeaddrinfo);
  const int error = connectTo(*found, limit_s);
  if (error == 0)
    return Answer::kAccepts;
  return error == ECONNREFUSED ? Answer::kRefuses : Answer::kNone;
}

std::optional<XmlRpc::XmlRpcValue> callApi(const XmlRpcServerAddress& address, const char* function,
                                           const XmlRpc::XmlRpcValue& arguments, double limit_s) {
  // A client prints every failure to connect.
  if (probe(address, limit_s) != Answer::kAccepts)
    return std::nullopt;
  Client client(address);
  XmlRpc::XmlRpcValue result;
  try {
    const bool answered = client.call(function, arguments, result, limit_s);
    // [code, text, payload], the code 1 for success.
    if (answered && result.getType() == XmlRpc::XmlRpcValue::TypeArray && result.size() == 3 &&
        static_cast<int>(result[0]) == 1)
      return result[2];
  } catch (const XmlRpc::XmlRpcException&) {
    // Not of the form that the API states.
  }
  return std::nullopt;
}

}  // namespace soft_volume
