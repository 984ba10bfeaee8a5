#pragma once

#include <xmlrpcpp/XmlRpcValue.h>

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "xmlrpc_call.h"

namespace soft_volume {

/// What a process takes part in: topics with their types, and services.
struct Registrations {
  std::map<std::string, std::string> publications;
  std::map<std::string, std::string> subscriptions;
  std::set<std::string> services;

  bool empty() const { return publications.empty() && subscriptions.empty() && services.empty(); }
  std::size_t size() const { return publications.size() + subscriptions.size() + services.size(); }
};

/// A connection of this process to a publisher.
struct PublisherLink {
  std::string topic;
  std::string publisher_uri;  ///< XML-RPC, as the master lists it
};

/// This process as others see it through its API. Null: it could not be asked, which a busy process may not answer in
/// time; that says nothing about what is there. A call ends within about two seconds.
namespace own_api {
/// Topics only: roscpp does not tell services.
std::optional<Registrations> registrations();
std::optional<std::vector<PublisherLink>> links();
/// Connects to these publishers of a topic and drops the connections to all others.
void updatePublishers(const std::string& topic, const std::set<std::string>& publisher_uris);
}  // namespace own_api

/// The master's side. Null or false: it could not be asked. A call ends within about two seconds, and as long as the
/// name of the master's host takes to resolve.
namespace master_api {
/// What it knows of this process.
std::optional<Registrations> registrations();
/// Names of the topics that somebody publishes; empty when it could not be asked. Throws nothing.
std::set<std::string> publishedTopics();
/// Names of the nodes that listen to a topic; empty when it could not be asked. Throws nothing.
std::set<std::string> subscribers(const std::string& topic);
bool registerPublisher(const std::string& topic, const std::string& type);
/// The publishers' XML-RPC URIs.
std::optional<std::set<std::string>> registerSubscriber(const std::string& topic, const std::string& type);
bool registerService(const std::string& service);
/// Null where it is not set, too.
std::optional<XmlRpc::XmlRpcValue> parameter(const std::string& name);
bool setParameter(const std::string& name, const XmlRpc::XmlRpcValue& value);
}  // namespace master_api

XmlRpcServerAddress addressOf(const std::string& uri);

}  // namespace soft_volume
