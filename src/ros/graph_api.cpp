#include "graph_api.h"

#include <ros/connection_manager.h>
#include <ros/console.h>
#include <ros/master.h>
#include <ros/network.h>
#include <ros/this_node.h>
#include <ros/xmlrpc_manager.h>
#include <xmlrpcpp/XmlRpcException.h>

#include <utility>

namespace soft_volume {
namespace {

using XmlRpc::XmlRpcValue;

constexpr double kLimit_s = 1.0;

const std::string& ownUri() {
  return ros::XMLRPCManager::instance()->getServerURI();
}

template <typename... Texts>
XmlRpcValue arguments(const Texts&... texts) {
  XmlRpcValue list;
  int n = 0;
  list[n++] = ros::this_node::getName();
  ((list[n++] = texts), ...);
  return list;
}

/// Through the loopback device: the address that others use may be gone with the network.
std::optional<XmlRpcValue> callOwn(const char* function, const XmlRpcValue& list) {
  return callApi({"127.0.0.1", addressOf(ownUri()).port}, function, list, kLimit_s);
}

std::optional<XmlRpcValue> callMaster(const char* function, const XmlRpcValue& list) {
  return callApi({ros::master::getHost(), static_cast<int>(ros::master::getPort())}, function, list, kLimit_s);
}

std::map<std::string, std::string> topicTypes(XmlRpcValue& list) {
  std::map<std::string, std::string> types;
  for (int n = 0; n < list.size(); ++n)
    types.emplace(std::string(list[n][0]), std::string(list[n][1]));
  return types;
}

/// Of a list [[name, [node...]]...], the names that have this node.
std::set<std::string> namesWithThisNode(XmlRpcValue& list) {
  std::set<std::string> names;
  for (int n = 0; n < list.size(); ++n) {
    for (int node = 0; node < list[n][1].size(); ++node) {
      if (std::string(list[n][1][node]) == ros::this_node::getName())
        names.insert(std::string(list[n][0]));
    }
  }
  return names;
}

/// For callers that expect no XmlRpcException, which is no std::exception: an answer is read as far as it has its form.
template <typename Read>
void readWhatIsThere(const Read& read) {
  try {
    read();
  } catch (const XmlRpc::XmlRpcException& error) {
    ROS_WARN_THROTTLE(10.0, "an answer of the master is not of its form: %s", error.getMessage().c_str());
  }
}

std::map<std::string, std::string> withoutTypes(const std::set<std::string>& topics) {
  std::map<std::string, std::string> types;
  for (const std::string& topic : topics)
    types.emplace(topic, "");
  return types;
}

}  // namespace

XmlRpcServerAddress addressOf(const std::string& uri) {
  XmlRpcServerAddress address;
  std::uint32_t port = 0;
  if (ros::network::splitURI(uri, address.host, port))
    address.port = static_cast<int>(port);
  return address;
}

std::optional<Registrations> own_api::registrations() {
  auto publications = callOwn("getPublications", arguments());
  auto subscriptions = callOwn("getSubscriptions", arguments());
  if (!publications || !subscriptions)
    return std::nullopt;
  return Registrations{topicTypes(*publications), topicTypes(*subscriptions), {}};
}

std::optional<std::vector<PublisherLink>> own_api::links() {
  auto list = callOwn("getBusInfo", arguments());
  if (!list)
    return std::nullopt;
  std::vector<PublisherLink> links;
  for (int n = 0; n < list->size(); ++n) {
    // [id, peer, direction, transport, topic...]; the peer of an incoming connection is an URI.
    XmlRpcValue& entry = (*list)[n];
    if (std::string(entry[2]) == "i" && std::string(entry[1]) != ownUri())
      links.push_back({std::string(entry[4]), std::string(entry[1])});
  }
  return links;
}

void own_api::updatePublishers(const std::string& topic, const std::set<std::string>& publisher_uris) {
  XmlRpcValue list;
  list.setSize(0);
  for (const std::string& uri : publisher_uris)
    list[list.size()] = uri;
  XmlRpcValue all = arguments(topic);
  all[2] = list;
  callOwn("publisherUpdate", all);
}

std::optional<Registrations> master_api::registrations() {
  auto state = callMaster("getSystemState", arguments());
  if (!state || state->size() != 3)
    return std::nullopt;
  Registrations known;
  known.publications = withoutTypes(namesWithThisNode((*state)[0]));
  known.subscriptions = withoutTypes(namesWithThisNode((*state)[1]));
  known.services = namesWithThisNode((*state)[2]);
  return known;
}

std::set<std::string> master_api::publishedTopics() {
  std::set<std::string> names;
  auto list = callMaster("getPublishedTopics", arguments(std::string()));
  readWhatIsThere([&] {
    for (int n = 0; list && n < list->size(); ++n)
      names.insert(std::string((*list)[n][0]));
  });
  return names;
}

std::set<std::string> master_api::subscribers(const std::string& topic) {
  std::set<std::string> names;
  auto state = callMaster("getSystemState", arguments());
  readWhatIsThere([&] {
    if (!state || state->size() != 3)
      return;
    XmlRpcValue& list = (*state)[1];
    for (int n = 0; n < list.size(); ++n) {
      for (int node = 0; std::string(list[n][0]) == topic && node < list[n][1].size(); ++node)
        names.insert(std::string(list[n][1][node]));
    }
  });
  return names;
}

bool master_api::registerPublisher(const std::string& topic, const std::string& type) {
  return callMaster("registerPublisher", arguments(topic, type, ownUri())).has_value();
}

std::optional<std::set<std::string>> master_api::registerSubscriber(const std::string& topic, const std::string& type) {
  auto list = callMaster("registerSubscriber", arguments(topic, type, ownUri()));
  if (!list)
    return std::nullopt;
  std::set<std::string> uris;
  for (int n = 0; n < list->size(); ++n)
    uris.insert(std::string((*list)[n]));
  return uris;
}

bool master_api::registerService(const std::string& service) {
  const std::string api =
      "rosrpc://" + ros::network::getHost() + ":" + std::to_string(ros::ConnectionManager::instance()->getTCPPort());
  return callMaster("registerService", arguments(service, api, ownUri())).has_value();
}

std::optional<XmlRpcValue> master_api::parameter(const std::string& name) {
  return callMaster("getParam", arguments(name));
}

bool master_api::setParameter(const std::string& name, const XmlRpcValue& value) {
  XmlRpcValue list = arguments(name);
  list[2] = value;
  return callMaster("setParam", list).has_value();
}

}  // namespace soft_volume
