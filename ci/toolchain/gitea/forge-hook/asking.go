package main

import (
	"bytes"
	"encoding/json"
	"errors"
	"fmt"
	"io"
	"net/http"
	"net/url"
	"strconv"
	"strings"
	"time"

	"gopkg.in/ini.v1"
)

const (
	answerTimeout = 10 * time.Minute // the forge ends its own work earlier
	answerBytes   = 16 << 20
)

// api is the forge's internal API, for one repository.
type api struct {
	address, token, owner, name string
	client                      *http.Client
}

// options are what the forge wants to know of a push; the names are those of its `HookOptions`.
type options struct {
	OldCommitIDs, NewCommitIDs, RefFullNames                               []string
	UserID                                                                 int64
	UserName                                                               string
	GitObjectDirectory, GitAlternativeObjectDirectories, GitQuarantinePath string
	GitPushOptions                                                         map[string]string
	PullRequestID                                                          int64
	PushTrigger                                                            string
	DeployKeyID                                                            int64
	IsWiki                                                                 bool
	ActionsTaskID                                                          int64
}

// connect reads from app.ini where the forge listens and what proves that this is its hook.
func connect(env func(string) string) (*api, error) {
	path := env("FORGE_CONFIG")
	if path == "" {
		path = configuration
	}
	file, err := ini.LoadSources(ini.LoadOptions{IgnoreContinuation: true}, path)
	if err != nil {
		return nil, fmt.Errorf("the forge's settings: %w", err)
	}
	found := &api{
		address: file.Section("server").Key("LOCAL_ROOT_URL").String(),
		token:   file.Section("security").Key("INTERNAL_TOKEN").String(),
		owner:   env("GITEA_REPO_USER_NAME"),
		name:    env("GITEA_REPO_NAME"),
		// No proxy is asked on the way to this very machine.
		client: &http.Client{Timeout: answerTimeout, Transport: &http.Transport{DisableKeepAlives: true}},
	}
	for what, value := range map[string]string{
		path + ": [server] LOCAL_ROOT_URL":   found.address,
		path + ": [security] INTERNAL_TOKEN": found.token,
		"GITEA_REPO_USER_NAME":               found.owner,
		"GITEA_REPO_NAME":                    found.name,
	} {
		if value == "" {
			return nil, fmt.Errorf("%s is missing", what)
		}
	}
	return found, nil
}

// options describe a push to the forge.
func (h *hook) options(changes []change, given map[string]string) *options {
	number := func(name string) int64 {
		value, _ := strconv.ParseInt(h.env(name), 10, 64)
		return value
	}
	found := &options{
		UserID:                          number("GITEA_PUSHER_ID"),
		UserName:                        h.env("GITEA_PUSHER_NAME"),
		GitObjectDirectory:              h.env("GIT_OBJECT_DIRECTORY"),
		GitAlternativeObjectDirectories: h.env("GIT_ALTERNATE_OBJECT_DIRECTORIES"),
		GitQuarantinePath:               h.env("GIT_QUARANTINE_PATH"),
		GitPushOptions:                  given,
		PullRequestID:                   number("GITEA_PR_ID"),
		PushTrigger:                     h.env("GITEA_PUSH_TRIGGER"),
		DeployKeyID:                     number("GITEA_DEPLOY_KEY_ID"),
		ActionsTaskID:                   number("GITEA_ACTIONS_TASK_ID"),
	}
	found.IsWiki, _ = strconv.ParseBool(h.env("GITEA_REPO_IS_WIKI"))
	for _, one := range changes {
		found.OldCommitIDs = append(found.OldCommitIDs, one.old)
		found.NewCommitIDs = append(found.NewCommitIDs, one.new)
		found.RefFullNames = append(found.RefFullNames, one.reference)
	}
	return found
}

func (a *api) post(what string, given, answer any) error { return a.postTo(what, nil, given, answer) }

// postTo asks `what` about the repository, with more words at the end of the address. What is not a success is an error
// with the forge's words for people.
func (a *api) postTo(what string, more []string, given, answer any) error {
	words := []string{strings.TrimSuffix(a.address, "/"), "api/internal", what, url.PathEscape(a.owner), url.PathEscape(a.name)}
	for _, word := range more {
		words = append(words, url.PathEscape(word))
	}
	body, err := json.Marshal(given)
	if err != nil {
		return err
	}
	request, err := http.NewRequest(http.MethodPost, strings.Join(words, "/"), bytes.NewReader(body))
	if err != nil {
		return err
	}
	request.Header.Set("Content-Type", "application/json")
	request.Header.Set("X-Real-IP", "127.0.0.1")
	request.Header.Set("X-Gitea-Internal-Auth", "Bearer "+a.token)
	response, err := a.client.Do(request)
	if err != nil {
		return fmt.Errorf("the forge does not answer its hook: %w", err)
	}
	defer response.Body.Close()
	text, err := io.ReadAll(io.LimitReader(response.Body, answerBytes))
	if err != nil {
		return fmt.Errorf("the forge's answer to its hook: %w", err)
	}
	if response.StatusCode/100 != 2 {
		return refusal(response.StatusCode, text)
	}
	if answer == nil {
		return nil
	}
	if err := json.Unmarshal(text, answer); err != nil {
		return fmt.Errorf("the forge's answer to its hook: %w", err)
	}
	return nil
}

func refusal(status int, text []byte) error {
	var said struct {
		UserMsg string `json:"user_msg"`
	}
	if json.Unmarshal(text, &said) == nil && said.UserMsg != "" {
		return errors.New(said.UserMsg)
	}
	return fmt.Errorf("the forge could not look at this push (status %d)", status)
}
