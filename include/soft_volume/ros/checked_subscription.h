#pragma once

#include <ros/node_handle.h>

#include <boost/make_shared.hpp>
#include <cstdint>
#include <exception>
#include <functional>
#include <string>
#include <utility>

#include "soft_volume/messages/checked_stream.h"
#include "soft_volume/ros/incident_log.h"

namespace soft_volume {

/// Reads messages with CheckedStream and reports those that cannot be read. Within a process they still come uncopied.
template <typename Message>
class CheckedReader : public ros::SubscriptionCallbackHelperT<const boost::shared_ptr<const Message>&> {
 public:
  using Callback = std::function<void(const boost::shared_ptr<const Message>&)>;

  CheckedReader(const Callback& callback, std::string topic, IncidentLog& incidents)
      : ros::SubscriptionCallbackHelperT<const boost::shared_ptr<const Message>&>(callback),
        topic_(std::move(topic)),
        incidents_(&incidents) {}

  ros::VoidConstPtr deserialize(const ros::SubscriptionCallbackHelperDeserializeParams& params) override {
    try {
      const auto message = boost::make_shared<Message>();
      CheckedStream stream(params.buffer, params.length);
      stream.next(*message);
      return message;
    } catch (const std::exception& error) {
      incidents_->report(topic_,
                         "a message of " + std::to_string(params.length) + " bytes is damaged: " + error.what());
      return {};
    }
  }

 private:
  std::string topic_;
  IncidentLog* incidents_;
};

/// Subscribes to a topic whose messages may be damaged or hostile: none of them costs more memory than its own size
/// calls for, and those that cannot be read are reported to `incidents`, which must outlive the subscriber.
template <typename Message>
ros::Subscriber subscribeChecked(ros::NodeHandle& node, const std::string& topic, std::uint32_t queue_size,
                                 const typename CheckedReader<Message>::Callback& callback, IncidentLog& incidents) {
  ros::SubscribeOptions options(topic, queue_size, ros::message_traits::md5sum<Message>(),
                                ros::message_traits::datatype<Message>());
  options.helper = boost::make_shared<CheckedReader<Message>>(callback, topic, incidents);
  options.transport_hints = ros::TransportHints().tcpNoDelay();
  return node.subscribe(options);
}

}  // namespace soft_volume
