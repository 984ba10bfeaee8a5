#include "soft_volume/ros/master_watch.h"

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/console.h>
#include <ros/init.h>
#include <ros/network.h>
#include <ros/service_manager.h>
#include <ros/this_node.h>
#include <xmlrpcpp/XmlRpcException.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <iterator>
#include <mutex>
#include <thread>

#include "graph_api.h"

namespace soft_volume {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds kInterval(1000);
/// While something is missing, or nobody answers.
constexpr std::chrono::milliseconds kShortInterval(300);
/// By then every node that looks at the master knows of its return and has registered its publishers.
constexpr std::chrono::milliseconds kPublishersFirst(1800);
/// TCP takes up a connection by itself as long after the end of an outage as that lasted.
constexpr std::chrono::milliseconds kOutage(1500);
constexpr double kProbe_s = 0.5;
constexpr int kConnectionAttempts = 5;

double seconds(Clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

const std::string& nameOf(const std::string& service) {
  return service;
}

const std::string& nameOf(const std::pair<const std::string, std::string>& topic_and_type) {
  return topic_and_type.first;
}

/// What is in `all` and not in `known`, by name.
template <typename Container>
Container without(const Container& all, const Container& known) {
  Container rest;
  for (const auto& entry : all) {
    if (known.count(nameOf(entry)) == 0)
      rest.insert(entry);
  }
  return rest;
}

Registrations missingOf(const Registrations& own, const Registrations& known) {
  return {without(own.publications, known.publications), without(own.subscriptions, known.subscriptions),
          without(own.services, known.services)};
}

bool isRemote(const std::string& host) {
  return host != ros::network::getHost() && host != "localhost" && host.compare(0, 4, "127.") != 0;
}

std::set<std::string> publishersOf(const std::vector<PublisherLink>& links, const std::string& topic) {
  std::set<std::string> uris;
  for (const PublisherLink& link : links) {
    if (link.topic == topic)
      uris.insert(link.publisher_uri);
  }
  return uris;
}

}  // namespace

class MasterWatch::Impl {
 public:
  Impl() {
    name_spaces_ = {ros::this_node::getName()};
    diagnostics_.setHardwareID("none");
    diagnostics_.add("graph", this, &Impl::diagnose);
    thread_ = std::thread([this] { run(); });
  }
  ~Impl() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      running_ = false;
    }
    wake_.notify_all();
    thread_.join();
  }

  void keepParameters(const std::string& name_space) {
    const std::lock_guard<std::mutex> lock(mutex_);
    name_spaces_.insert(name_space);
  }

 private:
  void run() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (running_ && ros::ok()) {
      lock.unlock();
      const bool settled = look();
      tellDiagnostics();
      lock.lock();
      wake_.wait_for(lock, settled ? kInterval : kShortInterval, [this] { return !running_; });
    }
  }

  /// False when the next look is to come soon.
  bool look() {
    try {
      const bool settled = lookAtMaster();
      return lookAtHosts() && settled;
    } catch (const XmlRpc::XmlRpcException& error) {
      ROS_WARN_THROTTLE(10.0, "an answer of the graph's API is not of its form: %s", error.getMessage().c_str());
    }
    return true;
  }

  bool lookAtMaster() {
    const std::optional<Registrations> known = master_api::registrations();
    if (!known) {
      setReached(false);
      return false;
    }
    setReached(true);
    const std::optional<Registrations> topics = own_api::registrations();
    if (!topics)
      return false;
    const Registrations own = withServices(*topics, *known);
    const Registrations missing = missingOf(own, *known);
    if (missing.empty()) {
      finish(own);
      keepNow();
      return !lists_due_;
    }
    // What is just being advertised is missing too, at the first look.
    if (missing_since_)
      registerAgain(missing);
    else
      missing_since_ = Clock::now();
    return false;
  }

  void setReached(bool reached) {
    if (reached == reached_)
      return;
    reached_ = reached;
    if (reached) {
      ROS_WARN("the master can be reached again");
      lists_due_ = Clock::now() + kPublishersFirst;
    } else {
      ROS_WARN("the master cannot be reached; connections go on");
    }
  }

  /// Services are known from the master alone; those that were given up meanwhile are left out.
  Registrations withServices(Registrations own, const Registrations& known) {
    services_.insert(known.services.begin(), known.services.end());
    for (const std::string& service : services_) {
      if (ros::ServiceManager::instance()->lookupServicePublication(service))
        own.services.insert(service);
    }
    services_ = own.services;
    return own;
  }

  void registerAgain(const Registrations& missing) {
    restoreParameters();
    for (const auto& [topic, type] : missing.publications)
      registered_ += master_api::registerPublisher(topic, type) ? 1 : 0;
    for (const std::string& service : missing.services)
      registered_ += master_api::registerService(service) ? 1 : 0;
    if (Clock::now() - *missing_since_ < kPublishersFirst)
      return;
    const auto links = own_api::links();
    if (!links)
      return;
    for (const auto& [topic, type] : missing.subscriptions)
      registered_ += subscribeAgain(topic, type, publishersOf(*links, topic)) ? 1 : 0;
  }

  /// Keeps connections to publishers that the master does not know: not every node registers again.
  bool subscribeAgain(const std::string& topic, const std::string& type, std::set<std::string> connected) {
    const auto listed = master_api::registerSubscriber(topic, type);
    if (!listed)
      return false;
    connected.insert(listed->begin(), listed->end());
    own_api::updatePublishers(topic, connected);
    return true;
  }

  void finish(const Registrations& own) {
    if (registered_ > 0) {
      const double time_s = seconds(Clock::now() - *missing_since_);
      ROS_WARN("the master had forgotten this node: %zu topics and services were registered again within %.1f s",
               registered_, time_s);
      const std::lock_guard<std::mutex> lock(mutex_);
      counts_.restarts += 1;
      counts_.registered += registered_;
      counts_.registering_s = time_s;
      lists_due_.reset();
    }
    registered_ = 0;
    missing_since_.reset();
    // Publishers may have come and gone while the master could not tell.
    if (!lists_due_ || Clock::now() < *lists_due_)
      return;
    lists_due_.reset();
    for (const auto& [topic, type] : own.subscriptions) {
      if (const auto listed = master_api::registerSubscriber(topic, type))
        own_api::updatePublishers(topic, *listed);
    }
  }

  std::set<std::string> keptNames() {
    const std::lock_guard<std::mutex> lock(mutex_);
    std::set<std::string> names = name_spaces_;
    names.insert("/use_sim_time");
    return names;
  }

  void keepNow() {
    for (const std::string& name : keptNames()) {
      if (const auto value = master_api::parameter(name))
        parameters_[name] = *value;
    }
  }

  void restoreParameters() {
    for (const auto& [name, value] : parameters_) {
      if (!master_api::parameter(name) && master_api::setParameter(name, value))
        ROS_INFO("parameter %s was set again", name.c_str());
    }
  }

  /// Whether hosts of publishers answer; false while one does not.
  bool lookAtHosts() {
    const auto links = own_api::links();
    if (!links)
      return false;
    completeRenewal(*links);
    std::map<std::string, XmlRpcServerAddress> hosts;
    for (const PublisherLink& link : *links) {
      const XmlRpcServerAddress address = addressOf(link.publisher_uri);
      if (isRemote(address.host))
        hosts.emplace(address.host, address);
    }
    for (auto silent = silent_since_.begin(); silent != silent_since_.end();)
      silent = hosts.count(silent->first) == 0 ? silent_since_.erase(silent) : std::next(silent);
    for (const auto& [host, address] : hosts)
      lookAtHost(address, *links);
    return silent_since_.empty() && renewing_.empty();
  }

  void lookAtHost(const XmlRpcServerAddress& address, const std::vector<PublisherLink>& links) {
    const bool answers = probe(address, kProbe_s) != Answer::kNone;
    const auto silent = silent_since_.find(address.host);
    if (!answers && silent == silent_since_.end())
      silent_since_[address.host] = Clock::now();
    if (!answers || silent == silent_since_.end())
      return;
    const Clock::duration outage = Clock::now() - silent->second;
    silent_since_.erase(silent);
    if (outage > kOutage)
      renew(address.host, seconds(outage), links);
  }

  void renew(const std::string& host, double outage_s, const std::vector<PublisherLink>& links) {
    std::set<std::string> topics;
    for (const PublisherLink& link : links) {
      if (addressOf(link.publisher_uri).host == host)
        topics.insert(link.topic);
    }
    ROS_WARN("%s answers again after %.1f s: %zu topics are connected anew", host.c_str(), outage_s, topics.size());
    for (const std::string& topic : topics) {
      const std::set<std::string> all = publishersOf(links, topic);
      std::set<std::string> others;
      std::copy_if(all.begin(), all.end(), std::inserter(others, others.end()),
                   [&host](const std::string& uri) { return addressOf(uri).host != host; });
      own_api::updatePublishers(topic, others);
      own_api::updatePublishers(topic, all);
      renewing_[topic] = {all, kConnectionAttempts};
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    counts_.renewed += topics.size();
  }

  /// A connection that could not be made is not tried again by roscpp.
  void completeRenewal(const std::vector<PublisherLink>& links) {
    for (auto renewal = renewing_.begin(); renewal != renewing_.end();) {
      const std::set<std::string> connected = publishersOf(links, renewal->first);
      std::set<std::string> wanted = renewal->second.publishers;
      const bool complete = std::includes(connected.begin(), connected.end(), wanted.begin(), wanted.end());
      wanted.insert(connected.begin(), connected.end());
      if (!complete && renewal->second.attempts_left-- > 0) {
        own_api::updatePublishers(renewal->first, wanted);
        ++renewal;
      } else {
        renewal = renewing_.erase(renewal);
      }
    }
  }

  void tellDiagnostics() {
    if (Clock::now() < diagnostics_due_)
      return;
    diagnostics_due_ = Clock::now() + kInterval;
    diagnostics_.force_update();
  }

  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
    using Level = diagnostic_msgs::DiagnosticStatus;
    const std::lock_guard<std::mutex> lock(mutex_);
    if (reached_)
      status.summary(Level::OK, "registered");
    else
      status.summary(Level::WARN, "the master cannot be reached; connections go on");
    status.add("times that the master forgot this node", counts_.restarts);
    status.add("topics and services registered again", counts_.registered);
    status.add("time of the last registering again [s]", counts_.registering_s);
    status.add("topics connected anew after their host was silent", counts_.renewed);
  }

  struct Counts {
    std::size_t restarts = 0;
    std::size_t registered = 0;
    double registering_s = 0.0;
    std::size_t renewed = 0;
  };
  struct Renewal {
    std::set<std::string> publishers;
    int attempts_left = 0;
  };

  diagnostic_updater::Updater diagnostics_;
  std::mutex mutex_;  // guards what follows
  std::condition_variable wake_;
  bool running_ = true;
  std::set<std::string> name_spaces_;
  Counts counts_;

  // In the thread.
  std::atomic<bool> reached_{true};
  std::optional<Clock::time_point> missing_since_;
  std::size_t registered_ = 0;                  // since then
  std::optional<Clock::time_point> lists_due_;  // when the lists of publishers are to be fetched
  std::set<std::string> services_;
  std::map<std::string, XmlRpc::XmlRpcValue> parameters_;
  std::map<std::string, Clock::time_point> silent_since_;  // by host
  std::map<std::string, Renewal> renewing_;                // by topic
  Clock::time_point diagnostics_due_;

  std::thread thread_;
};

MasterWatch::MasterWatch() : impl_(std::make_unique<Impl>()) {}
MasterWatch::~MasterWatch() = default;

std::shared_ptr<MasterWatch> MasterWatch::shared() {
  static std::mutex mutex;
  static std::weak_ptr<MasterWatch> watch;
  const std::lock_guard<std::mutex> lock(mutex);
  auto held = watch.lock();
  if (!held)
    watch = held = std::make_shared<MasterWatch>();
  return held;
}

void MasterWatch::keepParameters(const std::string& name_space) {
  impl_->keepParameters(name_space);
}

}  // namespace soft_volume
