// Part of RobotKube, not of FerretDB: what an authenticated account may do. See
// docs/decisions/0003-database-of-the-embedded-profile.md in RobotKube's repository.

package handler

import (
	"context"
	"errors"
	"fmt"

	"github.com/FerretDB/wire"

	"github.com/FerretDB/FerretDB/internal/clientconn/conninfo"
	"github.com/FerretDB/FerretDB/internal/handler/common"
	"github.com/FerretDB/FerretDB/internal/handler/handlererrors"
	"github.com/FerretDB/FerretDB/internal/handler/users"
	"github.com/FerretDB/FerretDB/internal/types"
	"github.com/FerretDB/FerretDB/internal/util/iterator"
	"github.com/FerretDB/FerretDB/internal/util/lazyerrors"
)

// requiredAccess says what a command needs on the database in its `$db`.
// A command that is not listed needs the role root: new commands, and those that name
// a database elsewhere than in `$db` (renameCollection, dataSize), are closed by default.
var requiredAccess = map[string]users.Access{
	"aggregate":       users.AccessRead,
	"collStats":       users.AccessRead,
	"count":           users.AccessRead,
	"dbStats":         users.AccessRead,
	"dbstats":         users.AccessRead,
	"distinct":        users.AccessRead,
	"explain":         users.AccessRead,
	"find":            users.AccessRead,
	"getMore":         users.AccessRead,
	"killCursors":     users.AccessRead,
	"listCollections": users.AccessRead,
	"listIndexes":     users.AccessRead,

	"create":        users.AccessWrite,
	"createIndexes": users.AccessWrite,
	"delete":        users.AccessWrite,
	"drop":          users.AccessWrite,
	"dropIndexes":   users.AccessWrite,
	"findAndModify": users.AccessWrite,
	"findandmodify": users.AccessWrite,
	"insert":        users.AccessWrite,
	"update":        users.AccessWrite,
}

// authorize returns an error unless the connection's account may run the command on the database the message names.
//
// It is called for every command that is not anonymous, after [checkSCRAMConversation].
// Roles are read from the stored account each time, so that a dropped account or role is refused at once.
func (h *Handler) authorize(ctx context.Context, command string, msg *wire.OpMsg) error {
	document, err := opMsgDocument(msg)
	if err != nil {
		return lazyerrors.Error(err)
	}

	// some handlers read the first, some the last of several equal keys
	var count int

	for _, key := range document.Keys() {
		if key == "$db" {
			count++
		}
	}

	dbName, err := common.GetRequiredParam[string](document, "$db")
	if err != nil {
		return err
	}

	if count != 1 {
		return unauthorized(command, dbName)
	}

	access, ok := requiredAccess[command]
	if !ok {
		access = users.AccessRoot
	}

	roles, err := h.roles(ctx)
	if err != nil {
		return lazyerrors.Error(err)
	}

	if !users.Allow(roles, dbName, access) {
		return unauthorized(command, dbName)
	}

	return nil
}

// roles returns the stored roles of the connection's account; none if the account is not stored.
func (h *Handler) roles(ctx context.Context) ([]users.Role, error) {
	username, _, _, authDB := conninfo.Get(ctx).Auth()

	adminDB, err := h.b.Database("admin")
	if err != nil {
		return nil, lazyerrors.Error(err)
	}

	coll, err := adminDB.Collection("system.users")
	if err != nil {
		return nil, lazyerrors.Error(err)
	}

	qr, err := coll.Query(ctx, nil)
	if err != nil {
		return nil, lazyerrors.Error(err)
	}

	defer qr.Iter.Close()

	for {
		_, doc, err := qr.Iter.Next()

		switch {
		case errors.Is(err, iterator.ErrIteratorDone):
			return nil, nil
		case err != nil:
			return nil, lazyerrors.Error(err)
		}

		if id, _ := doc.Get("_id"); id != authDB+"."+username {
			continue
		}

		stored, _ := doc.Get("roles")
		array, ok := stored.(*types.Array)

		if !ok {
			return nil, nil
		}

		return users.ParseRoles(array, authDB)
	}
}

// unauthorized returns the error MongoDB answers with, too.
func unauthorized(command, dbName string) error {
	return handlererrors.NewCommandErrorMsgWithArgument(
		handlererrors.ErrUnauthorized,
		fmt.Sprintf("not authorized on %s to execute command %s", dbName, command),
		command,
	)
}
